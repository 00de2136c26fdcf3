"""Plans that begin alike share the steps of their common prefix.

Time is cut into segments. In each segment one world stands for all plans of a scene with the same removals up to its
end. Where plans differ, the world is copied. So a search over plans that differ late, or in few blocks, plays fewer
worlds. An episode that is done is played no further.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.batching import Group, group_by_topology, plan_slots_for
from iphyre_jax.execution.compilation.executables import prepare
from iphyre_jax.execution.devices import Partition, on_cpu, runner
from iphyre_jax.execution.layout import WORD, Words
from iphyre_jax.execution.programs import Advance, episode_layout
from iphyre_jax.execution.threads import run_all
from iphyre_jax.physics.types import Topology, World

SEGMENTS: Final = 15  # more of them share more steps, but each is a call for every group of worlds

Ints = npt.NDArray[np.int64]


def score_prefixes(
    worlds: Sequence[tuple[Topology, World]],
    scene_index: Ints,
    plan: npt.NDArray[np.int32],
    timing: npt.NDArray[np.floating],
    steps: int,
    partition: Partition,
    dtype: str,
) -> npt.NDArray[np.int32]:
    """Return success, steps, eliminations and fault of plans, (4, B).

    Args:
        worlds: of each scene, see `cached_world`, with the contact slots that they may use.
        scene_index: (B,) scene of each plan.
        plan: (B, S) steps before which blocks go, -1 for never.
        timing: of a physics step, see `pack_timing`.
        steps: physics steps of a whole episode.
        partition: of the devices.
        dtype: of the physics.
    """
    counts = np.zeros((4, len(plan)), np.int32)
    rows, node, episodes = np.arange(len(plan)), np.zeros(len(plan), np.int64), None
    for stop_step in np.unique(np.linspace(0, steps, SEGMENTS + 1).astype(int)[1:]).tolist():
        alike = np.where(plan[rows] < stop_step, plan[rows], -1)  # later removals do not count yet
        keys = np.concatenate([scene_index[rows, None], alike], axis=1)
        _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        leaders, starts = rows[first], None if episodes is None else episodes[node[first]]
        segment = _Segment(worlds, scene_index[leaders], plan[leaders], timing, stop_step, partition, dtype)
        episodes, results = segment.run(starts)
        node = inverse
        counts[:, rows] = results[node, :4].T
        active = results[node, 4] == 0
        rows, node = rows[active], node[active]
        if not len(rows):
            break
    return counts


@dataclass(frozen=True)
class _Segment:
    """A segment of N worlds: the arguments of `score_prefixes`, with N for B, and the step to play to."""

    worlds: Sequence[tuple[Topology, World]]
    scene_index: Ints
    plan: npt.NDArray[np.int32]
    timing: npt.NDArray[np.floating]
    stop_step: int
    partition: Partition
    dtype: str

    def run(self, starts: Words | None) -> tuple[Words, npt.NDArray[np.int32]]:
        """Play from episodes (N, words), or from the start; return episodes, and their counts and `done`, (N, 5)."""
        every = np.arange(len(self.scene_index))
        groups = group_by_topology(self.worlds, self.scene_index, every, self.dtype, self._lanes)
        if on_cpu():
            prepare([self._program(group) for group in groups])
        layouts = [episode_layout(topology, self.dtype) for topology, _ in self.worlds]
        after = np.zeros((len(every), max(layout.rows for layout in layouts)), WORD[self.dtype])
        results = np.zeros((len(every), 5), np.int32)
        run_all(partial(self._run_group, starts, after, results), groups)
        return after, results

    def _lanes(self, topology: Topology) -> int:
        return self.partition.lanes(topology, self.dtype)

    def _program(self, group: Group) -> Advance:
        lanes = self.partition.lanes(group.topology, self.dtype, len(group.rows))
        return Advance(group.topology, self.dtype, lanes, plan_slots_for(self.plan))

    def _run_group(self, starts: Words | None, after: Words, results: npt.NDArray[np.int32], group: Group) -> None:
        program, count = self._program(group), len(group.rows)
        layout = episode_layout(program.topology, self.dtype)
        episodes = np.zeros((layout.rows, program.lanes), layout.word)
        if starts is not None:
            episodes[:, :count] = starts[group.rows, : layout.rows].T
            episodes[:, count:] = episodes[:, count - 1 : count]
        steps = np.array([self.stop_step, starts is None], np.int32)
        plans = group.plans(self.plan, program.plan_slots, program.lanes)
        run = runner(program, self.partition.mesh)
        played = run(group.worlds(program.lanes), plans, self.timing, steps, episodes)[0][:, :count]
        out = layout.unpack_numpy(played).result
        after[group.rows, : layout.rows] = played.T
        results[group.rows] = np.stack([out.success, out.steps, out.eliminations, out.fault, out.done], axis=1)

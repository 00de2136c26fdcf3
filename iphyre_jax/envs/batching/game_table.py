"""The games of one set of parameters on the host, and the calls of programs for worlds that play them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.host_observations import HostObservations
from iphyre_jax.envs.batching.step_program import GROUPS, EnvStep, scene_layout
from iphyre_jax.execution.batching import lane_slices
from iphyre_jax.execution.compilation.client import aligned
from iphyre_jax.execution.layout import fill_lanes

STEPS: Final = 48  # of the groups of a call together; threads share what is longer

Ints = npt.NDArray[np.signedinteger[Any]]
Floats = npt.NDArray[np.float32]
Selection = npt.NDArray[np.intp] | slice


@dataclass(frozen=True, eq=False)
class ProgramCall:
    """Worlds of one topology that one call of its program plays."""

    number: int  # among the calls of its topology
    topology_id: int
    rows: Selection
    games: Ints  # of the worlds, sorted


class GameTable:
    """Packed scenes, and each game's episode and observation before its first step.

    Args:
        key: identifies the scenes and their topologies.
        scenes: (games, words), see `scene_layout`.
        topology_id: (games,) index into the programs.
        programs: one for each topology.
        observations: of these games.
    """

    def __init__(
        self, key: bytes, scenes: Ints, topology_id: Ints, programs: Sequence[EnvStep], observations: HostObservations
    ) -> None:
        self.key, self.topology_id, self.observations = key, topology_id, observations
        self._programs = programs
        present = np.unique(topology_id).tolist()
        self._topology_ids = sorted(present, key=lambda one: -programs[one].topology.moving)  # the costliest first
        # The place of each game in the order by topology; small integers sort fastest.
        self._sort_key = np.empty(len(topology_id), np.uint16 if len(topology_id) < 2**16 else np.int64)
        self._sort_key[np.argsort(topology_id, kind="stable")] = np.arange(len(topology_id))
        layouts = [scene_layout(program.topology, program.dtype) for program in programs]
        self.scenes = [np.ascontiguousarray(scenes[:, : layout.rows]) for layout in layouts]
        self.start_words: Ints = np.zeros(0, scenes.dtype)  # (games, words), set by `HostStep`
        self.start_obs: Floats = np.zeros(0, np.float32)  # (games, D)
        # By topology and number of the call: the game of each lane, and their packed scenes, as the program takes them.
        self._packed: dict[tuple[int, int], tuple[Ints, Ints]] = {}

    def calls(self, game: Ints, steps: int) -> list[ProgramCall]:
        """Sort worlds by topology and game, and share them out to calls.

        Args:
            game: (B,) of each world.
            steps: the most physics steps that a world makes.
        """
        groups = min(GROUPS, max(1, STEPS // max(1, steps)))
        if len(self.topology_id) == 1:
            return self._cut(self._topology_ids[0], None, game, groups)
        order = np.argsort(self._sort_key[game], kind="stable")
        games = game[order]
        counts = np.bincount(self.topology_id[games], minlength=len(self._programs))
        ends = np.cumsum(counts)
        calls = []
        for topology_id in self._topology_ids:
            part = slice(ends[topology_id] - counts[topology_id], ends[topology_id])
            calls += self._cut(topology_id, order[part], games[part], groups)
        return calls

    def _cut(self, topology_id: int, rows: npt.NDArray[np.intp] | None, games: Ints, groups: int) -> list[ProgramCall]:
        """Share out the worlds of one topology, so many groups to a call; rows: None for all worlds as they stand."""
        parts = enumerate(lane_slices(len(games), groups * self._programs[topology_id].lanes))
        return [ProgramCall(k, topology_id, part if rows is None else rows[part], games[part]) for k, part in parts]

    @contextmanager
    def packed_scenes(self, call: ProgramCall) -> Iterator[Ints]:
        """Yield the packed scenes of the lanes of a call, see `EnvStep`; spare lanes repeat the last world's.

        They stay from decision to decision: only lanes whose game has changed are written.
        """
        topology_id, key = call.topology_id, (call.topology_id, call.number)
        program = self._programs[topology_id]
        # Nobody else has them meanwhile: another thread that makes the same call begins with none.
        kept = self._packed.pop(key, None)
        games, packed = _unpacked(program) if kept is None else kept
        wanted = fill_lanes(call.games, -(-len(call.games) // program.lanes) * program.lanes)
        changed = np.flatnonzero(games[: len(wanted)] != wanted)
        games[changed] = wanted[changed]
        packed[changed // program.lanes, :, changed % program.lanes] = self.scenes[topology_id][wanted[changed]]
        yield packed
        self._packed[key] = games, packed


def _unpacked(program: EnvStep) -> tuple[Ints, Ints]:
    """Return no games, and room for the packed scenes of a call."""
    scenes = program.arguments()[0]
    return np.full(program.most_worlds, -1), aligned(scenes.shape, scenes.dtype)

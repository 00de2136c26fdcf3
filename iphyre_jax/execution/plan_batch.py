"""Batches of plans: what plays them, in groups of worlds that run side by side, and where their results go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.batching import Group, Indices, group_by_topology, plan_slots_for
from iphyre_jax.execution.compilation.executables import prepare
from iphyre_jax.execution.devices import Partition, gather, on_cpu, runner
from iphyre_jax.execution.prefixes import score_prefixes
from iphyre_jax.execution.programs import Advance, Score, episode_layout, pack_timing
from iphyre_jax.execution.threads import run_all
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

ATTEMPTS = 4  # at a play that needs more contact slots than it was given


def _slots(topology: Topology) -> tuple[int, ...]:
    """Return the contact slots of each attempt: few, for time and compile time grow with them, then more and more.

    None of 800,000 random plans of the forty games at 10 fps needs a second attempt: at most 2 slots with one ball, 4
    with two, 8 with a bar and a ball, 9 in all others. Of 2000 crowded random scenes 8 need a third.
    """
    few = min(10, 2 * topology.balls + 6 * topology.bars)
    return few, topology.slots, 2 * topology.slots, 4 * topology.slots


@dataclass(frozen=True)
class Settings:
    """The checked keyword arguments of `simulate_many`."""

    fps: float
    steps: int
    dtype: str
    resets: int
    sample_every: int | None
    share_prefixes: bool = False


@dataclass(frozen=True, eq=False)
class PlanBatch:
    """B plays: what they are and what came of them so far."""

    scenes: list[Scene]
    worlds: list[tuple[Topology, World]]  # of the scenes
    scene_index: npt.NDArray[np.int64]  # (B,) scene of each
    plan: npt.NDArray[np.int32]  # (B, S)
    settings: Settings
    partition: Partition
    success: npt.NDArray[np.bool_]
    steps: npt.NDArray[np.int64]
    eliminations: npt.NDArray[np.int64]
    fault: npt.NDArray[np.int64]
    samples: npt.NDArray[np.floating[Any]] | None

    @classmethod
    def of(
        cls,
        scenes: list[Scene],
        worlds: list[tuple[Topology, World]],
        scene_index: npt.NDArray[np.int64],
        plan: npt.NDArray[np.int32],
        settings: Settings,
        partition: Partition,
    ) -> PlanBatch:
        """Return plays before they are played."""
        size, every = len(plan), settings.sample_every
        samples = None
        if every is not None:
            shape = size, settings.steps // every + 1, max((scene.n_objects for scene in scenes), default=0), 3
            samples = np.full(shape, np.nan, settings.dtype)
        steps, eliminations, fault = (np.zeros(size, np.int64) for _ in range(3))
        success = np.zeros(size, bool)
        return cls(scenes, worlds, scene_index, plan, settings, partition, success, steps, eliminations, fault, samples)

    def run(self, rows: Indices, attempt: int) -> None:
        """Play some rows; in several processes, each its own groups of them, and gather the results."""
        partition, dtype = self.partition, self.settings.dtype
        if self.settings.share_prefixes:
            self._run_prefixes(rows, attempt)
            return
        groups = group_by_topology(
            self.worlds, self.scene_index, rows, dtype, lambda topology: partition.lanes(topology, dtype), self._alike
        )
        if on_cpu():
            prepare([self._program(group.topology, attempt) for group in groups])
        dealt = [groups[process_index :: partition.process_count] for process_index in range(partition.process_count)]
        run_all(partial(self._run_group, attempt), dealt[partition.process_index])
        if partition.process_count > 1:
            of_processes = [np.concatenate([rows[:0], *(group.rows for group in part)]) for part in dealt]
            for array in (self.success, self.steps, self.eliminations, self.fault, self.samples):
                if array is not None:
                    gather(partition, of_processes, array)

    def _run_prefixes(self, rows: Indices, attempt: int) -> None:
        settings = self.settings
        worlds = [(self._roomy(topology, attempt), world) for topology, world in self.worlds]
        times = step_timing(settings.fps, settings.dtype)
        scene_index, plan = self.scene_index[rows], self.plan[rows]
        counts = score_prefixes(worlds, scene_index, plan, times, settings.steps, self.partition, settings.dtype)
        self._write(rows, counts)

    def _roomy(self, topology: Topology, attempt: int) -> Topology:
        return replace(topology, slots=_slots(topology)[attempt])

    def _program(self, topology: Topology, attempt: int) -> Score | Advance:
        kind = Score if self.samples is None else Advance
        roomy = self._roomy(topology, attempt)
        dtype = self.settings.dtype
        return kind(roomy, dtype, self.partition.lanes(topology, dtype), plan_slots_for(self.plan))

    def _run_group(self, attempt: int, group: Group) -> None:
        program = self._program(group.topology, attempt)
        run, settings = runner(program, self.partition.mesh), self.settings
        worlds = group.worlds(program.lanes)
        plans = group.plans(self.plan, program.plan_slots, program.lanes)
        times = pack_timing(step_timing(settings.fps, settings.dtype))
        if isinstance(program, Score):
            counts = run(worlds, plans, times, np.array([settings.steps, 1], np.int32))[0]
            self._write(group.rows, counts[:, : len(group.rows)])
            return
        layout = episode_layout(program.topology, program.dtype)
        episodes, moved = np.zeros((layout.rows, program.lanes), layout.word), []
        for stop in self._stops():
            episodes = run(worlds, plans, times, np.array([stop, 1, stop == 0], np.int32), episodes)[0]
            result = layout.unpack_numpy(episodes).result
            moved.append(np.stack([result.position.x, result.position.y, result.angle], -1)[:, : len(group.rows)])
        counts = np.stack([result.success, result.steps, result.eliminations, result.fault])
        self._write(group.rows, counts[:, : len(group.rows)])
        self._write_samples(group, np.stack(moved))

    def _stops(self) -> list[int]:
        """Return the step counts at which samples are taken, and the last step."""
        every, steps = self.settings.sample_every or self.settings.steps, self.settings.steps
        return sorted({*range(0, steps + 1, every), steps})

    def _write(self, rows: Indices, counts: npt.NDArray[np.integer[Any]]) -> None:
        for array, values in zip((self.success, self.steps, self.eliminations, self.fault), counts, strict=True):
            array[rows] = values

    def _write_samples(self, group: Group, moved: npt.NDArray[np.floating[Any]]) -> None:
        """Write the poses of all objects; moved: (stops, n, used, 3) of those that move."""
        samples = cast(npt.NDArray[np.floating[Any]], self.samples)
        moved, stops = moved[: samples.shape[1]], self._stops()
        for index in np.unique(group.scene_index):
            scene, at = self.scenes[index], group.scene_index == index
            rows = group.rows[at]
            poses = _poses(scene, moved[:, :, at])
            _blank_removed(scene, poses, self.plan[rows], self.steps[rows], stops)
            samples[rows, :, : scene.n_objects] = poses

    def _alike(self, rows: Indices) -> Indices:
        return _alike(rows, self.plan)


def _alike(rows: npt.NDArray[np.integer[Any]], plan: npt.NDArray[np.int32]) -> npt.NDArray[np.integer[Any]]:
    """Return the rows of one scene sorted by the order in which their blocks go, then by the times.

    Neighbours in a chunk then touch the same things at the same time, which a chunk computes once for all.
    """
    times = np.where(plan[rows] < 0, np.iinfo(np.int32).max, plan[rows])
    order = np.argsort(times, axis=1, kind="stable")
    keys = np.concatenate([np.sort(times, axis=1)[:, ::-1], order[:, ::-1]], axis=1)  # the last key is the first
    return rows[np.lexsort(keys.T)] if keys.shape[1] else rows


def _poses(scene: Scene, moved: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.floating[Any]]:
    """Return x, y and angle of every object, (B, K, N, 3), removed ones included; moved: (K, n, B, 3), who moves."""
    poses = np.zeros((moved.shape[2], moved.shape[0], scene.n_objects, 3), moved.dtype)
    poses[:, :, : scene.n_blocks, :2] = (scene.blocks[:, 0] + scene.blocks[:, 1]) / 2
    poses[:, :, np.flatnonzero(scene.dynamic)] = moved.transpose(2, 0, 1, 3)
    return poses


def _blank_removed(
    scene: Scene,
    poses: npt.NDArray[np.floating[Any]],
    plan: npt.NDArray[np.int32],
    made: npt.NDArray[np.integer[Any]],
    stops: list[int],
) -> None:
    """Write NaN for removed objects; one removed before step k is in the sample after k steps for the last time."""
    at = np.array(stops[: poses.shape[1]])
    for column, block in enumerate(scene.eliminable_blocks[: plan.shape[1]]):
        when = plan[:, column]
        done = (when >= 0) & (when < made)
        row, sample = np.nonzero(done[:, None] & (at > when[:, None]))
        poses[row, sample, block] = np.nan

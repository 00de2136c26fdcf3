"""Batches of plans: play them in groups of lanes and collect the results in the caller's order."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution.batching import Group, Indices, group_by_topology, plan_slots_for
from iphyre_jax.execution.compilation.executables import load_cached, prepare
from iphyre_jax.execution.devices import Partition, gather, on_cpu, runner
from iphyre_jax.execution.prefixes import score_prefixes
from iphyre_jax.execution.programs import Advance, Score, episode_layout, pack_timing
from iphyre_jax.execution.threads import run_all
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.rollouts import FAULT_OVERFLOW
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

ATTEMPTS = 4  # at a plan that needs more contact slots than it was given


def contact_slots(topology: Topology) -> tuple[int, ...]:
    """Return the contact slots of each attempt: few at first."""
    return topology.few_slots, topology.slots, 2 * topology.slots, 4 * topology.slots


@lru_cache(1024)
def _with_contact_slots(topology: Topology, attempt: int) -> Topology:
    return replace(topology, slots=contact_slots(topology)[attempt])


@dataclass(frozen=True)
class Settings:
    """The checked keyword arguments of `simulate_many`."""

    fps: float
    steps: int
    dtype: str
    resets: int
    sample_every: int | None
    share_prefixes: bool = False


@dataclass(eq=False)
class PlanBatch:
    """B plans and their results so far."""

    scenes: list[Scene]
    worlds: list[tuple[Topology, World]]  # of the scenes
    scene_index: npt.NDArray[np.int64]  # (B,) scene of each plan
    plan: npt.NDArray[np.int32]  # (B, S)
    settings: Settings
    partition: Partition
    success: npt.NDArray[np.bool_] = field(init=False)
    steps: npt.NDArray[np.int64] = field(init=False)
    eliminations: npt.NDArray[np.int64] = field(init=False)
    fault: npt.NDArray[np.int64] = field(init=False)
    samples: npt.NDArray[np.floating[Any]] | None = None

    def __post_init__(self) -> None:
        """Make room for the results."""
        size, every = len(self.plan), self.settings.sample_every
        self.success = np.zeros(size, bool)
        self.steps, self.eliminations, self.fault = (np.zeros(size, np.int64) for _ in range(3))
        if every is not None:
            objects = max((scene.n_objects for scene in self.scenes), default=0)
            self.samples = np.full((size, self.settings.steps // every + 1, objects, 3), np.nan, self.settings.dtype)

    def play(self) -> None:
        """Play all rows; what lacks contact slots is played again with more."""
        left = np.arange(len(self.plan))
        for attempt in range(ATTEMPTS):
            if left.size:
                self.run(left, attempt)
                left = left[self.fault[left] == FAULT_OVERFLOW]

    def run(self, rows: Indices, attempt: int) -> None:
        """Play some rows. With several processes, each plays its own groups, and all gather the results."""
        partition = self.partition
        if self.settings.share_prefixes:
            self._run_prefixes(rows, attempt)
            return
        groups = self._groups(rows)
        if on_cpu():
            prepare([self._program(group, attempt) for group in groups])
        own = [groups[index :: partition.process_count] for index in range(partition.process_count)]
        run_all(partial(self._run_group, attempt), own[partition.process_index])
        if partition.process_count > 1:
            of_processes = [np.concatenate([rows[:0], *(group.rows for group in part)]) for part in own]
            for array in (self.success, self.steps, self.eliminations, self.fault, self.samples):
                if array is not None:
                    gather(partition, of_processes, array)

    def is_cached(self) -> bool:
        """Return whether nothing needs to be compiled for the first attempt at all rows; loads what is cached."""
        groups = self._groups(np.arange(len(self.plan)))
        return all(load_cached(self._program(group, attempt=0)) for group in groups)

    def _groups(self, rows: Indices) -> list[Group]:
        dtype = self.settings.dtype
        lanes = partial(self.partition.lanes, dtype=dtype)
        return group_by_topology(self.worlds, self.scene_index, rows, dtype, lanes, self._sort_alike)

    def _run_prefixes(self, rows: Indices, attempt: int) -> None:
        settings = self.settings
        worlds = [(_with_contact_slots(topology, attempt), world) for topology, world in self.worlds]
        scene_index, plan = self.scene_index[rows], self.plan[rows]
        counts = score_prefixes(worlds, scene_index, plan, self._timing, settings.steps, self.partition, settings.dtype)
        self._write(rows, counts)

    @cached_property
    def _timing(self) -> npt.NDArray[np.floating]:
        return pack_timing(step_timing(self.settings.fps, self.settings.dtype))

    def _program(self, group: Group, attempt: int) -> Score | Advance:
        program = Score if self.samples is None else Advance
        own, dtype = _with_contact_slots(group.topology, attempt), self.settings.dtype
        lanes = self.partition.lanes(group.topology, dtype, len(group.rows))
        return program(own, dtype, lanes, plan_slots_for(self.plan))

    def _run_group(self, attempt: int, group: Group) -> None:
        program = self._program(group, attempt)
        run, settings = runner(program, self.partition.mesh), self.settings
        worlds = group.worlds(program.lanes)
        plans = group.plans(self.plan, program.plan_slots, program.lanes)
        timing = self._timing
        if isinstance(program, Score):
            counts = run(worlds, plans, timing, np.array([settings.steps], np.int32))[0]
            self._write(group.rows, counts[:, : len(group.rows)])
            return
        layout = episode_layout(program.topology, program.dtype)
        episodes, moving = np.zeros((layout.rows, program.lanes), layout.word), []
        for stop in self._stops():
            episodes = run(worlds, plans, timing, np.array([stop, stop == 0], np.int32), episodes)[0]
            result = layout.unpack_numpy(episodes).result
            moving.append(np.stack([result.position.x, result.position.y, result.angle], -1)[:, : len(group.rows)])
        counts = np.stack([result.success, result.steps, result.eliminations, result.fault])
        self._write(group.rows, counts[:, : len(group.rows)])
        self._write_samples(group, np.stack(moving))

    def _stops(self) -> list[int]:
        """Return the steps after which samples are taken, and the last step."""
        every, steps = self.settings.sample_every or self.settings.steps, self.settings.steps
        return sorted({*range(0, steps + 1, every), steps})

    def _write(self, rows: Indices, counts: npt.NDArray[np.integer[Any]]) -> None:
        for array, values in zip((self.success, self.steps, self.eliminations, self.fault), counts, strict=True):
            array[rows] = values

    def _write_samples(self, group: Group, moving: npt.NDArray[np.floating[Any]]) -> None:
        """Write the poses of all objects; moving: (stops, n, worlds, 3) of the moving bodies."""
        samples = cast(npt.NDArray[np.floating[Any]], self.samples)
        moving, stops = moving[: samples.shape[1]], self._stops()
        for index in np.unique(group.scene_index):
            scene, at = self.scenes[index], group.scene_index == index
            rows = group.rows[at]
            poses = _poses(scene, moving[:, :, at])
            _blank_removed(scene, poses, self.plan[rows], self.steps[rows], stops)
            samples[rows, :, : scene.n_objects] = poses

    def _sort_alike(self, rows: Indices) -> Indices:
        """Sort the rows of one scene by the order of their removals, then by the steps, both from the last one back.

        Neighbours in a group then touch the same things at the same step, which the group computes once, and end at
        about the same step.
        """
        plan = self.plan[rows]
        steps = np.where(plan < 0, np.iinfo(np.int32).max, plan)
        order = np.argsort(steps, axis=1, kind="stable")
        keys = np.concatenate([np.sort(steps, axis=1), order], axis=1)  # lexsort: the last key first
        return rows[np.lexsort(keys.T)] if keys.shape[1] else rows


def _poses(scene: Scene, moving: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.floating[Any]]:
    """Return x, y, angle of all objects, (B, K, N, 3), removed ones included; moving: (K, n, B, 3), moving bodies."""
    poses = np.zeros((moving.shape[2], moving.shape[0], scene.n_objects, 3), moving.dtype)
    poses[..., :2] = scene.centres
    poses[:, :, np.flatnonzero(scene.dynamic)] = moving.transpose(2, 0, 1, 3)
    return poses


def _blank_removed(
    scene: Scene,
    poses: npt.NDArray[np.floating[Any]],
    plan: npt.NDArray[np.int32],
    played: npt.NDArray[np.integer[Any]],
    stops: list[int],
) -> None:
    """Write NaN for removed objects; the sample after k steps is the last with an object removed before step k."""
    at = np.array(stops[: poses.shape[1]])
    for slot, block in enumerate(scene.eliminable_blocks[: plan.shape[1]]):
        removal = plan[:, slot]
        removed = (removal >= 0) & (removal < played)
        row, sample = np.nonzero(removed[:, None] & (at > removal[:, None]))
        poses[row, sample, block] = np.nan

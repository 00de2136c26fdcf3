"""Recordings: one play with every frame, for pictures and pages.

`simulate` plays batches. `record` plays a single world and keeps all poses, velocities and contact points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_dtype, check_integers, check_resets, show, whole_fps
from iphyre_jax.execution import programs
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.compilation.executables import executable, load_cached
from iphyre_jax.execution.plan_batch import contact_slots
from iphyre_jax.memory import check_memory
from iphyre_jax.rollouts import FAULT_OVERFLOW
from iphyre_jax.rules import NEVER, TIME_LIMIT, episode_reward
from iphyre_jax.scenes import Scene, SceneLike, load_scene
from iphyre_jax.scenes.compile import step_timing, topology_of
from iphyre_jax.viewer.record_program import Frames, RecordProgram

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Recording:
    """One play of N objects in F = steps + 1 frames. Frame k is the world after k steps; frame 0 is the start.

    Attributes:
        scene: the scene.
        plan: for each eliminable block the step before which it is removed, -1 for never.
        fps: physics steps a second; each step is a frame.
        dtype: number type of the physics, "float64" or "float32".
        resets: number of the reset in a reused space.
        poses: (F, N, 3) x, y (px) and angle (rad) of every object, removed ones included.
        velocities: (F, N, 2) px/s, without the bias velocities of the solver; zero at the start and for static objects.
        contacts: (F, K, 2) px, contact points; NaN in unused rows.
        success: whether every ball fell below the lower edge of the picture.
        steps: number of physics steps, including the one that solved the game.
        eliminations: number of removed blocks.
        reward: 1000 if solved, minus 10 for each removed block, minus 1 for each second.
        fault: 0 for a valid play, else a code of `iphyre_jax.rollouts`.
    """

    scene: Scene
    plan: tuple[int, ...]
    fps: int
    dtype: str
    resets: int
    poses: Floats
    velocities: Floats
    contacts: Floats
    success: bool
    steps: int
    eliminations: int
    reward: float
    fault: int

    @classmethod
    def of_poses(
        cls, scene: Scene, plan: npt.ArrayLike, poses: npt.ArrayLike, *, fps: int = 60, success: bool = False
    ) -> Recording:
        """Make a recording from given poses, such as the samples of `simulate` or the poses of another engine.

        Args:
            scene: the scene.
            plan: as for `record`.
            poses: (F, N, 3) x, y (px) and angle (rad) of every object at the start and after every step, up to the
                last step; NaN for removed objects.
            fps: physics steps a second.
            success: whether the play solved the game.

        Returns:
            The recording. Velocities are differences of poses. It has no contacts.

        Raises:
            ValueError: one line that names the argument and what was expected.
        """
        steps, rate = _full_plan(scene, plan), whole_fps(fps)
        try:
            filled = np.array(poses, np.float64)
        except (ValueError, TypeError):
            raise ValueError(f"poses: expected numbers of shape (F, {scene.n_objects}, 3), got {show(poses)}") from None
        if filled.ndim != 3 or not len(filled) or filled.shape[1:] != (scene.n_objects, 3):
            raise ValueError(f"poses: expected shape (F, {scene.n_objects}, 3), got {filled.shape}")
        filled = np.where(np.isnan(filled), filled[:1], filled)  # only static bars are removed; they stay in place
        if not np.isfinite(filled).all():
            raise ValueError("poses: expected finite numbers in the first frame, and NaN only for removed objects")
        velocities = np.zeros((*filled.shape[:2], 2))
        velocities[1:] = np.diff(filled[:, :, :2], axis=0) * rate
        made = len(filled) - 1
        removed = sum(NEVER < step < made for step in steps)
        reward = episode_reward(np.array([success]), np.array([removed]), np.array([made]), rate)
        empty = np.full((len(filled), 0, 2), np.nan)
        result = bool(success), made, removed, float(reward[0]), 0
        return cls(scene, tuple(steps), rate, "float64", 1, filled, velocities, empty, *result)

    @property
    def last_frames(self) -> npt.NDArray[np.int64]:
        """(N,) the last frame in which each object is present."""
        last = np.full(self.scene.n_objects, self.steps, np.int64)
        for block, step in zip(self.scene.eliminable_blocks, self.plan, strict=True):
            if NEVER < step < self.steps:
                last[block] = step
        return last


class NotCompiledError(RuntimeError):
    """A recording needs a program that has to be compiled."""


def record(
    scene: SceneLike,
    plan: npt.ArrayLike,
    *,
    fps: int = 60,
    dtype: str = "float64",
    resets: int = 1,
    may_compile: bool = True,
) -> Recording:
    """Play one plan and keep every frame.

    Runs on the host and gives the same result as `simulate`; in float64 all bits are equal.

    Args:
        scene: a game's name, the path of a scene file or a Scene.
        plan: (S,) integers, for each eliminable block the step before which it is removed, -1 for never; blocks without
            an entry stay. Further entries are -1, as in a row of a batch.
        fps: physics steps a second, a whole number of at most 100,000, if the scene allows as many steps as 15 s take.
        dtype: number type of the physics, "float64" or "float32".
        resets: number of the reset in a reused space, 1 to 2**31 - 1; 1 is a fresh space.
        may_compile: whether a program may be compiled that is neither in memory nor in the cache folder.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: the scene file cannot be read.
        NotCompiledError: a program is missing and may not be compiled.
    """
    scene = load_scene(scene)
    rate, steps = whole_fps(fps), _full_plan(scene, plan)
    dtype, resets = check_dtype(dtype), check_resets(resets)
    topology, world = cached_world(scene, resets, dtype)
    first = record_program(scene, fps=rate, dtype=dtype)
    padded = np.full(first.columns, NEVER, np.int32)
    padded[: len(steps)] = steps
    words = programs.world_layout(topology, dtype).pack_many([world])
    for slots in contact_slots(topology)[1:]:  # `simulate` begins with fewer
        program = replace(first, topology=replace(topology, slots=slots))
        frame = 3 * 8 * (5 * scene.n_objects + 2 * slots)  # as JAX's, as NumPy's, and cut to the length
        check_memory("fps", program.length * frame, "record at a lower rate")
        if not may_compile and not load_cached(program):
            raise NotCompiledError
        counts, *frames = executable(program)(words, padded, programs.pack_timing(step_timing(rate, dtype)))
        success, made, eliminations, fault = counts.tolist()
        if fault != FAULT_OVERFLOW:
            break
    reward = episode_reward(np.array([success]), np.array([eliminations]), np.array([made]), rate)
    poses, velocities, points = _object_arrays(scene, Frames(*frames), made + 1)
    result = bool(success), made, eliminations, float(reward[0]), fault
    return Recording(scene, tuple(steps), rate, dtype, resets, poses, velocities, points, *result)


def record_program(scene: Scene, *, fps: int = 60, dtype: str = "float64") -> RecordProgram:
    """Return the program that `record` runs for such a recording; arguments and errors are those of `record`."""
    topology, length = topology_of(scene), int(TIME_LIMIT * whole_fps(fps))
    if length > (limit := topology.max_steps):
        raise ValueError(f"fps: expected at most {limit} steps in {TIME_LIMIT:g} s for this scene, got {length}")
    return RecordProgram(topology, check_dtype(dtype), scene.limits.blocks, length)


def _full_plan(scene: Scene, plan: npt.ArrayLike) -> list[int]:
    """Check a plan and return it with an entry for each eliminable block."""
    blocks = len(scene.eliminable_blocks)
    entries = check_integers("plan", plan, f"at most {blocks} integers", 1)
    if len(entries) > blocks and (entries[blocks:] != NEVER).any():  # a row of a batch has an entry for each slot
        raise ValueError(f"plan: expected at most {blocks} integers, got {len(entries)}")
    if entries.size and (entries.min() < NEVER or entries.max() > np.iinfo(np.int32).max):
        raise ValueError(f"plan: expected step indices or -1, got {entries.min()} to {entries.max()}")
    return [*entries[:blocks].tolist(), *[NEVER] * (blocks - len(entries))]


def _object_arrays(scene: Scene, frames: Frames, count: int) -> tuple[Floats, Floats, Floats]:
    """Return poses and velocities of all objects in list order, and contacts, of the first `count` frames."""
    poses = np.zeros((count, scene.n_objects, 3))
    poses[..., :2] = scene.centres
    velocities = np.zeros((count, scene.n_objects, 2))
    moving = np.flatnonzero(scene.dynamic)
    poses[:, moving] = frames.pose[:count]
    velocities[:, moving] = frames.velocity[:count]
    return poses, velocities, np.asarray(frames.contact[:count], np.float64)

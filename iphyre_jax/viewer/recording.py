"""Recordings: one play, step by step, with everything that pictures and pages show of it.

`simulate` plays batches; a recording is a single world with all its poses, velocities and contact points. It stands on
the same `rollouts.episode_step`, compiled for one world without lanes, which takes milliseconds for a whole play.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.execution import programs
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.compilation.executables import executable
from iphyre_jax.physics.broad_phase import max_steps
from iphyre_jax.plans import NEVER, TIME_LIMIT
from iphyre_jax.rules import episode_reward, whole_fps
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing
from iphyre_jax.viewer.record_program import Frames, RecordProgram

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Recording:
    """One play. Frame k is the world after k steps; frame 0 is the start; F = steps + 1 frames, N objects.

    Attributes:
        scene: what was played.
        plan: for each eliminable block the step before which it was to go, -1 for never.
        fps: physics steps a second, as many as frames.
        dtype: of the physics, "float64" or "float32".
        resets: number of the reset of a reused space.
        poses: (F, N, 3) x, y (px) and angle (rad) of every object, also of removed ones.
        velocities: (F, N, 2) px/s, without the solver's bias; zero at the start and for what does not move.
        contacts: (F, K, 2) px, points at which bodies touch; NaN in unused rows.
        success: every ball fell below the picture's lower edge.
        steps: physics steps made, the solving one included.
        eliminations: blocks removed by then.
        reward: 1000 if solved, less 10 for each removed block, less 1 for each second.
        fault: 0 if sound, else a code of `iphyre_jax.rollouts`.
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
        """Make a recording of poses from elsewhere: the samples of `simulate`, or another engine.

        Args:
            scene: what was played.
            plan: as for `record`.
            poses: (F, N, 3) x, y (px) and angle (rad) of every object at the start and after every step, and nothing
                beyond the end; NaN for objects that are gone.
            fps: physics steps a second.
            success: how it ended.

        Returns:
            The recording; velocities are differences of poses, contacts are unknown and left out.

        Raises:
            ValueError: one line that names the argument and what was expected.
        """
        steps, filled, rate = _full_plan(scene, plan), np.array(poses, np.float64), whole_fps(fps)
        if filled.ndim != 3 or not len(filled) or filled.shape[1:] != (scene.n_objects, 3):
            raise ValueError(f"poses: expected shape (F, {scene.n_objects}, 3), got {filled.shape}")
        filled = np.where(np.isnan(filled), filled[:1], filled)  # only static bars go; they are where they were
        if not np.isfinite(filled).all():
            raise ValueError("poses: expected finite numbers in the first frame, and NaN only for what is gone")
        velocities = np.zeros((*filled.shape[:2], 2))
        velocities[1:] = np.diff(filled[:, :, :2], axis=0) * rate
        made = len(filled) - 1
        gone = sum(NEVER < step < made for step in steps)
        reward = episode_reward(np.array([success]), np.array([gone]), np.array([made]), rate)
        empty = np.full((len(filled), 0, 2), np.nan)
        fields = {"poses": filled, "velocities": velocities, "contacts": empty}
        return cls(
            scene,
            tuple(steps),
            rate,
            "float64",
            1,
            **fields,
            success=bool(success),
            steps=made,
            eliminations=gone,
            reward=float(reward[0]),
            fault=0,
        )

    @property
    def last_frames(self) -> npt.NDArray[np.int64]:
        """(N,) the last frame in which an object is there; the last of all for what stays."""
        last = np.full(self.scene.n_objects, self.steps, np.int64)
        for block, step in zip(self.scene.eliminable_blocks, self.plan, strict=True):
            if NEVER < step < self.steps:
                last[block] = step
        return last


def record(scene: Scene, plan: npt.ArrayLike, *, fps: int = 60, dtype: str = "float64", resets: int = 1) -> Recording:
    """Play one plan and keep every frame.

    A host function, as `simulate`, with the same outcome: in float64 to the last bit.

    Args:
        scene: what to play.
        plan: (S,) integers, for each eliminable block the step before which it goes, -1 for never; missing ones stay.
        fps: physics steps a second.
        dtype: "float64" or "float32", of the physics.
        resets: number of the reset of a reused space; 1 is a fresh one.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    rate, steps = whole_fps(fps), _full_plan(scene, plan)
    if dtype not in ("float32", "float64"):
        raise ValueError(f'dtype: expected "float32" or "float64", got {dtype!r}')
    if isinstance(resets, bool) or not isinstance(resets, int | np.integer) or resets < 1:
        raise ValueError(f"resets: expected a whole number of at least 1, got {resets!r}")
    topology, world = cached_world(scene, int(resets), dtype)
    length = int(TIME_LIMIT * rate)
    if length > (limit := max_steps(topology)):
        raise ValueError(f"fps: expected at most {limit} steps in {TIME_LIMIT:g} s for this scene, got {length}")
    padded = np.full(scene.limits.blocks, NEVER, np.int32)
    padded[: len(steps)] = steps
    words = programs.world_layout(topology, dtype).pack_many([world])
    program = executable(RecordProgram(topology, dtype, len(padded), length))
    counts, *frames = program(words, padded, programs.clock(step_timing(rate, dtype)))
    success, made, eliminations, fault = counts.tolist()
    return Recording(
        scene=scene,
        plan=tuple(steps),
        fps=rate,
        dtype=dtype,
        resets=int(resets),
        **_object_arrays(scene, Frames(*frames), made + 1),
        success=bool(success),
        steps=made,
        eliminations=eliminations,
        reward=float(episode_reward(np.array([success]), np.array([eliminations]), np.array([made]), rate)[0]),
        fault=fault,
    )


def _full_plan(scene: Scene, plan: npt.ArrayLike) -> list[int]:
    """Return the checked plan with an entry for each eliminable block."""
    entries, blocks = np.asarray(plan), len(scene.eliminable_blocks)
    if entries.ndim != 1 or (entries.size and entries.dtype.kind not in "iu") or len(entries) > blocks:
        raise ValueError(f"plan: expected at most {blocks} integers, got {entries.dtype} of shape {entries.shape}")
    if entries.size and (entries.min() < NEVER or entries.max() > np.iinfo(np.int32).max):
        raise ValueError(f"plan: expected step indices or -1, got {entries.min()} to {entries.max()}")
    return [*entries.tolist(), *[NEVER] * (blocks - len(entries))]


def _object_arrays(scene: Scene, frames: Frames, count: int) -> dict[str, Floats]:
    """Return poses and velocities of all objects in list order, and contacts, of the frames played."""
    poses = np.zeros((count, scene.n_objects, 3))
    poses[:, : scene.n_blocks, :2] = (scene.blocks[:, 0] + scene.blocks[:, 1]) / 2
    velocities = np.zeros((count, scene.n_objects, 2))
    moving = np.flatnonzero(scene.dynamic)
    poses[:, moving] = frames.pose[:count]
    velocities[:, moving] = frames.velocity[:count]
    return {
        "poses": poses,
        "velocities": velocities,
        "contacts": np.asarray(frames.contact[:count], np.float64),
    }

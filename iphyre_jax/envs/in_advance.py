"""In-advance episodes as plans: an agent observes the start and gives six times; `simulate_many` plays the game.

The official learning setting is 10 steps a second in the second reset of a space.
Source: `IPHYRE_inadvance` of the official package 0.2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_resets, check_which, check_whole, show
from iphyre_jax.observations.official import start_observation
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import NEVER, OFFICIAL_FPS, OFFICIAL_RESETS, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE, SceneLike, load_scenes
from iphyre_jax.scenes.limits import MOST_OBJECTS
from iphyre_jax.simulation import simulate_many


@dataclass(frozen=True, eq=False)
class PlanResults:
    """Results of B in-advance episodes, in the caller's order."""

    reward: npt.NDArray[np.float64]  # (B,) 1000 if solved - 10 x eliminations - seconds
    success: npt.NDArray[np.bool_]  # (B,)
    steps: npt.NDArray[np.integer[Any]]  # (B,) physics steps made
    eliminations: npt.NDArray[np.integer[Any]]  # (B,) blocks removed
    fault: npt.NDArray[np.integer[Any]]  # (B,) 0 for a sound world
    eliminate_at: npt.NDArray[np.int64]  # (B, 6) the planned step of each removal, -1 for never

    @property
    def terminated(self) -> npt.NDArray[np.bool_]:
        """Whether the game was solved, (B,)."""
        return self.success

    @property
    def truncated(self) -> npt.NDArray[np.bool_]:
        """Whether the time ran out, (B,)."""
        return ~self.success


def observation_table(scenes: Sequence[SceneLike]) -> npt.NDArray[np.float32]:
    """Return the observations at the start of S scenes, (S, 120) float32, wider if a scene's limits are larger."""
    return np.stack([start_observation(scene) for scene in load_scenes(scenes)])


def action_to_times(actions: npt.ArrayLike, slots: int = MAX_ELIMINABLE) -> npt.NDArray[np.floating[Any]]:
    """Return the seconds of the official actions, (B, 6): 15 x action, in the dtype of the actions.

    Args:
        actions: (B, 6) float32 or float64 in [0, 1]; column s is the time of slot s as a share of 15 s.
        slots: 6, or more if a scene's limits are larger.

    Raises:
        ValueError: another shape or dtype, a NaN or a value outside [0, 1]; one line.
    """
    check_whole("slots", slots, 1, MOST_OBJECTS)
    try:
        checked = np.asarray(actions)
    except (ValueError, TypeError):  # rows of unequal length, or a value that JAX traces
        raise ValueError(f"actions: expected an array of shape (B, {slots}), got {show(actions)}") from None
    if checked.dtype not in (np.float32, np.float64):
        raise ValueError(f"actions: expected float32 or float64, got dtype {checked.dtype}")
    if checked.ndim != 2 or checked.shape[1] != slots:
        raise ValueError(f"actions: expected shape (B, {slots}), got {checked.shape}")
    inside = (checked >= 0) & (checked <= 1)  # False for NaN
    if not inside.all():
        row, column = np.argwhere(~inside)[0]
        raise ValueError(
            f"actions: expected values in [0, 1], got {checked[row, column]} in row {row}, column {column}"
        )
    return checked * checked.dtype.type(TIME_LIMIT)


def play_plans(
    scenes: Sequence[SceneLike],
    which: npt.ArrayLike,
    actions: npt.ArrayLike,
    *,
    fps: int = OFFICIAL_FPS,
    resets: int = OFFICIAL_RESETS,
    dtype: str = "float32",
) -> PlanResults:
    """Play B in-advance episodes of any mix of scenes.

    Args:
        scenes: S names, files or scenes.
        which: (B,) whole numbers in [0, S): the scene of each episode.
        actions: (B, 6) float in [0, 1], see `action_to_times`; slots beyond a scene's blocks do nothing.
        fps: physics steps a second, a multiple of 10 (the agent's times are tenths of a second), 10 to 100,000.
        resets: number of the reset of a reused space, 1 to 2**31 - 1; 2 is the official environment's.
        dtype: of the physics, "float32" or "float64".

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    loaded = load_scenes(scenes)
    slots = loaded[0].limits.blocks
    check_resets(resets)
    times = action_to_times(actions, slots)
    index = check_which(which, len(loaded))
    if len(index) != len(times):
        raise ValueError(f"actions: expected {len(index)} rows as in which, got {len(times)}")
    blocks = np.array([len(scene.eliminable_blocks) for scene in loaded])[index]
    steps = plan_to_steps(times, fps, "in_advance")
    steps = np.where(np.arange(slots) < blocks[:, None], steps, NEVER)
    # A trained policy repeats its plans; equal plans end alike, so each is played once.
    unique, inverse = np.unique(np.column_stack([index, steps]), axis=0, return_inverse=True)
    which, plans = unique[:, 0], unique[:, 1:]
    played = simulate_many(loaded, which, plans, fps=fps, duration=TIME_LIMIT, dtype=dtype, resets=resets)
    return PlanResults(
        reward=played.reward[inverse],
        success=played.success[inverse],
        steps=played.steps[inverse],
        eliminations=played.eliminations[inverse],
        fault=played.fault[inverse],
        eliminate_at=steps,
    )

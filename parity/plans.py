"""Random plans: which blocks are removed, and before which step."""

import zlib
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene

PlanSet = Literal["early", "late"]

EARLY_LIMIT = 6.0  # s: removal times of the early set lie in (0, 6)
LATE_LIMIT = 10.0  # s: those of the late set in [0, 10)
FIRST_STEP_SHARE = 0.1  # share of the late set's removals that come before the first step


def random_times(scene: Scene, count: int, seed: int, plan_set: PlanSet = "early") -> NDArray[np.float64]:
    """Draw removal times in seconds.

    Plan 0 removes nothing. Every other plan removes some of the scene's eliminable blocks: how many (at least one) and
    which are drawn uniformly. The draw depends on the seed, the scene's name and the set alone, so a game's plans do
    not depend on the other games of a run. Times are in seconds, so that a plan means the same at every frame rate.

    Args:
        scene: the scene.
        count: number of plans, B.
        seed: of the whole run, at least 0.
        plan_set: "early", times in (0, 6) s, or "late", times in [0, 10) s of which a tenth are exactly 0.

    Returns:
        (B, S) float64, one column for each eliminable block, NaN for a block that stays.

    Raises:
        ValueError: if `count` or `seed` is negative.
    """
    if count < 0:
        raise ValueError(f"count: expected at least 0 plans, got {count!r}")
    if seed < 0:
        raise ValueError(f"seed: expected an integer of at least 0, got {seed!r}")
    rng = np.random.default_rng([seed, zlib.crc32(scene.name.encode()), int(plan_set == "late")])
    slots = len(scene.eliminable_blocks)
    times = np.full((count, slots), np.nan)
    if slots == 0:
        return times
    for row in times[1:]:
        chosen = rng.permutation(slots)[: rng.integers(1, slots + 1)]
        row[chosen] = _draw(rng, len(chosen), plan_set)
    return times


def _draw(rng: np.random.Generator, count: int, plan_set: PlanSet) -> NDArray[np.float64]:
    if plan_set == "early":
        return EARLY_LIMIT * (1.0 - rng.random(count))  # 1 - [0, 1) keeps 0 out
    times = LATE_LIMIT * rng.random(count)
    return np.where(rng.random(count) < FIRST_STEP_SHARE, 0.0, times)


def to_steps(times: NDArray[np.float64], fps: int) -> NDArray[np.int32]:
    """The first step that starts at or after each time (rounded up), -1 where the time is NaN.

    Args:
        times: (B, S) float64 seconds.
        fps: physics steps a second.

    Returns:
        (B, S) int32, `eliminate_at` of `iphyre_jax.simulate`.
    """
    steps = np.ceil(np.nan_to_num(times, nan=-1.0) * fps)
    return np.where(np.isnan(times), -1, steps).astype(np.int32)


def random_plans(scene: Scene, count: int, fps: int, seed: int, plan_set: PlanSet = "early") -> NDArray[np.int32]:
    """`random_times` as steps at one frame rate: (B, S) int32, `eliminate_at` of `iphyre_jax.simulate`."""
    return to_steps(random_times(scene, count, seed, plan_set), fps)

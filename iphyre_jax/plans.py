"""`plan_to_steps`: elimination times in seconds to physics steps, by the rules of the official code.

A plan gives each eliminable block a time; the simulator takes the physics step before which the block goes. The
official code has two drivers with different rules. `simulate` (people, oracle, data sets) keeps a clock that
accumulates rounding and takes one entry a frame. The in-advance learning environment rounds to tenths of a second and
loses ties.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_option, is_list, show, whole_fps
from iphyre_jax.memory import check_memory
from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER, TIME_LIMIT

NEVER_WORDS = ("never", "-")  # in a plan that a person writes

if TYPE_CHECKING:
    from iphyre_jax.scenes import Scene

Rule = Literal["simulate", "in_advance"]
_REMEDY = "turn fewer plans at a time into steps"


def plan_to_steps(times: npt.ArrayLike, fps: int, rule: Rule) -> npt.NDArray[np.int64]:
    """Turn plans in seconds into the `eliminate_at` of `simulate`.

    Args:
        times: (B, S) float32 or float64 (integers become float64), s, not negative; column s belongs to the s-th
            eliminable block; NaN: the plan has no entry for it.
        fps: physics steps a second, a whole number from 1 to 100,000; for "in_advance" a multiple of 10.
        rule: "simulate", for people and data sets: entries are taken in order of time (equal times in column order), at
            most one a frame, at the first frame whose clock has reached the time. An entry at 0 takes its frame and
            removes nothing. "in_advance", for the learning environment: times are rounded to 0.1 s (half to even, in
            the dtype of `times`) and looked up at 0.1, 0.2, ..., 14.9 s. Of equal rounded times only the lowest column
            counts. 0 and times from 15.0 on mean never.

    Returns:
        (B, S) int64: 0-based index of the physics step before which the block is removed, -1 for never. "simulate" runs
        while its accumulated clock is below 15 s. At some rates that is one step more than 15 x fps (151 at 10 fps). An
        entry in that last frame keeps its index (150), which a world of exactly 15 s does not reach.

    Raises:
        ValueError: one line naming the argument and what was expected.

    Source: `IPHYRE.simulate` and `IPHYRE_inadvance.step` of the official package 0.2.3.
    """
    check_option("rule", rule, get_args(Rule))
    rate = whole_fps(fps)
    plans = _checked_times(times)
    if rule == "simulate":
        check_memory("times", 60 * plans.size, _REMEDY)
        return _simulate_steps(plans.astype(np.float64), rate)
    check_memory("times", (60 + 4 * plans.shape[1]) * plans.size, _REMEDY)
    return _in_advance_steps(plans, rate)


def _checked_times(times: npt.ArrayLike) -> npt.NDArray[np.floating[Any]]:
    """Return the plans as a (B, S) float32 or float64 array, or raise a one-line ValueError."""
    try:
        plans = np.asarray(times)
    except ValueError:
        raise ValueError("times: expected a rectangular (B, S) array, got rows of unequal length") from None
    except TypeError:  # JAX's, for a traced value
        raise ValueError(f"times: expected an array, as this runs on the host, got {show(times)}") from None
    if plans.dtype.kind in "iu":
        plans = plans.astype(np.float64)
    if plans.dtype not in (np.float32, np.float64):
        raise ValueError(f"times: expected float32 or float64 seconds, got dtype {plans.dtype}")
    if plans.ndim != 2:
        raise ValueError(f"times: expected shape (B, S), got {plans.shape}")
    if np.isinf(plans).any():
        raise ValueError("times: expected finite seconds or NaN for no entry, got an infinite time")
    if (plans < 0).any():
        row, column = np.argwhere(plans < 0)[0]
        raise ValueError(f"times: expected no negative time, got {plans[row, column]} in row {row}, column {column}")
    return plans


def official_clock(fps: float) -> npt.NDArray[np.float64]:
    """Return the clock of the official `simulate` at the start of each frame, (F,) s.

    The driver adds 1/fps while the sum is below 15. So the clock carries the rounding of all additions: 900 frames at
    60 fps, 151 at 10 fps.
    """
    clock = np.full(int(TIME_LIMIT * fps) + 2, 1 / fps)
    clock[0] = 0.0
    clock = np.add.accumulate(clock)  # adds in sequence, like the driver's loop
    return clock[clock < TIME_LIMIT]


def _simulate_steps(times: npt.NDArray[np.float64], fps: int) -> npt.NDArray[np.int64]:
    """Return the steps of (B, S) float64 seconds by the rule "simulate"."""
    clock = official_clock(fps)
    order = np.argsort(times, axis=1, kind="stable")  # NaN sorts last
    entries = np.take_along_axis(times, order, axis=1)
    due = np.searchsorted(clock, entries, side="left")  # first frame with clock >= time
    # One entry a frame: entry j takes max(due_j, frame_{j-1} + 1), a running maximum of due_j - j.
    column = np.arange(times.shape[1])
    frame = np.maximum.accumulate(due - column, axis=1) + column if times.shape[1] else due
    executed = (entries > 0) & (frame < len(clock))  # False for NaN
    steps = np.empty(times.shape, np.int64)
    np.put_along_axis(steps, order, np.where(executed, frame, NEVER), axis=1)
    return steps


def _in_advance_steps(times: npt.NDArray[np.floating[Any]], fps: int) -> npt.NDArray[np.int64]:
    """Return the steps of (B, S) float32 or float64 seconds by the rule "in_advance".

    `envs.strategies.InAdvance` has the same rule in JAX; a test holds the two equal.
    """
    if fps % DECISIONS_PER_SECOND:
        raise ValueError(f"fps: expected a multiple of {DECISIONS_PER_SECOND} for rule 'in_advance', got {fps}")
    # np.round(times, 1) is rint(times * 10) / 10 in the dtype of `times`; the integer is the frame.
    bounded = np.minimum(times, times.dtype.type(TIME_LIMIT + 1))  # keeps the product finite
    tenths = np.rint(bounded * times.dtype.type(DECISIONS_PER_SECOND))
    last = int(TIME_LIMIT * DECISIONS_PER_SECOND) - 1
    valid = (tenths >= 1) & (tenths <= last)  # False for NaN
    frame = np.where(valid, tenths, NEVER).astype(np.int64)
    # A column is lost if an earlier column of its row has the same frame.
    same = frame[:, :, None] == frame[:, None, :]
    lost = np.tril(same, k=-1).any(axis=2)
    return np.where(valid & ~lost, frame * (fps // DECISIONS_PER_SECOND), NEVER)


def steps_to_times(steps: npt.NDArray[np.integer[Any]], fps: int) -> npt.NDArray[np.float64]:
    """Return times, s, NaN for never, from which `plan_to_steps` by the rule "simulate" makes these steps again.

    They are half a step early, so that the rounding of the clock does not count. The rule never gives step 0: a removal
    there gets the time of step 1. Nor does it give a step twice: of blocks with equal times one goes a step later.

    Args:
        steps: of any shape, as `plan_to_steps` returns them.
        fps: physics steps a second.
    """
    return np.where(steps < 0, np.nan, (np.maximum(steps, 1) - 0.5) / fps)


def parse_plan(words: Sequence[str], scene: Scene) -> npt.NDArray[np.float64]:
    """Read a plan as people write it: a time for each eliminable block, or "never" or "-" for one that stays.

    0 is taken too. It removes nothing, by the official rules.

    Args:
        words: times in seconds, in the order of the scene's eliminable blocks; blocks without a word stay.
        scene: the scene to play.

    Returns:
        (1, S) float64, s, as `plan_to_steps` takes them; NaN for a block that stays.

    Raises:
        ValueError: one line; a word is not a time, or there are more words than eliminable blocks.
    """
    blocks = len(scene.eliminable_blocks)
    if not is_list(words):
        raise ValueError(f"plan: expected a sequence of times, got {show(words)}")
    if len(words) > blocks:
        raise ValueError(f"plan: expected at most {blocks} times (eliminable blocks of {scene.name}), got {len(words)}")
    seconds = np.full((1, blocks), np.nan)
    for k, word in enumerate(words):
        try:
            seconds[0, k] = np.nan if word in NEVER_WORDS else float(word)
        except (ValueError, TypeError, OverflowError):
            seconds[0, k] = -1.0
        if seconds[0, k] < 0 or np.isinf(seconds[0, k]) or (np.isnan(seconds[0, k]) and word not in NEVER_WORDS):
            raise ValueError(f"plan: expected seconds above 0, or never, separated by spaces, got {show(word)}")
    return seconds

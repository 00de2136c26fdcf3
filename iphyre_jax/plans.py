"""Elimination times in seconds to physics steps, by the rules of the official code.

A plan gives each eliminable block a time; the simulator wants the index of the physics step
before which the block goes. The official code has two drivers, and they differ: `simulate`
(people, oracle, data sets) keeps a clock that accumulates rounding and takes one entry a frame,
the in-advance learning environment rounds to tenths of a second and loses ties.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import whole_fps
from iphyre_jax.rules import DECISIONS_PER_SECOND, NEVER, TIME_LIMIT

NEVER_WORDS = ("never", "-")  # in a plan that a person writes

if TYPE_CHECKING:
    from iphyre_jax.scenes import Scene

Rule = Literal["simulate", "in_advance"]


def plan_to_steps(times: npt.ArrayLike, fps: int, rule: Rule) -> npt.NDArray[np.int64]:
    """Turn plans in seconds into the `eliminate_at` of `simulate`.

    Args:
        times: (B, S) float32 or float64 (whole numbers are taken as float64), s, not negative;
            column s belongs to the s-th eliminable block; NaN: the plan has no entry for it.
        fps: physics steps a second, a positive whole number; for "in_advance" a multiple of 10.
        rule: "simulate", the driver of people and data sets: entries in order of time (stable,
            so equal times go in column order), at most one a frame, taken at the first frame
            whose clock has reached its time; an entry at 0 takes its frame and removes nothing.
            "in_advance", the learning environment: times rounded to 0.1 s (half to even, in the
            type of `times`), looked up at 0.1, 0.2, ..., 14.9 s; of equal rounded times only the
            lowest column is executed, the others are lost; 0 and anything from 15.0 on is never.

    Returns:
        (B, S) int64: 0-based index of the physics step before which the block is removed, -1 for
        never. "simulate" runs while its accumulated clock is below 15 s, which at some rates is
        one step more than 15 x fps (151 at 10 fps); an entry in that last frame keeps its index
        (150), which a world of exactly 15 s does not reach.

    Raises:
        ValueError: one line naming the argument and what was expected.

    Source: `IPHYRE.simulate` and `IPHYRE_inadvance.step` of the official package 0.2.3.
    """
    plans = _checked_times(times)
    rate = whole_fps(fps)
    if rule == "simulate":
        return _simulate_steps(plans.astype(np.float64), rate)
    if rule == "in_advance":
        return _in_advance_steps(plans, rate)
    raise ValueError(f"rule: expected one of {', '.join(get_args(Rule))}, got {rule!r}")


def _checked_times(times: npt.ArrayLike) -> npt.NDArray[np.floating[Any]]:
    """The plans as a (B, S) float32 or float64 array, or a one-line ValueError."""
    try:
        plans = np.asarray(times)
    except ValueError:
        raise ValueError("times: expected a rectangular (B, S) array, got rows of unequal length") from None
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


def official_clock(fps: int) -> npt.NDArray[np.float64]:
    """(F,) clock of the official `simulate` at the start of each of its frames, s.

    The driver adds 1/fps to a float until it is no longer below 15, so the clock carries the
    rounding of all additions: 900 frames at 60 fps, 151 at 10 fps.
    """
    clock = np.full(int(TIME_LIMIT * fps) + 2, 1 / fps)
    clock[0] = 0.0
    clock = np.add.accumulate(clock)  # one addition after the other, as the driver's loop
    return clock[clock < TIME_LIMIT]


def _simulate_steps(times: npt.NDArray[np.float64], fps: int) -> npt.NDArray[np.int64]:
    """Rule "simulate" for (B, S) float64 seconds."""
    clock = official_clock(fps)
    order = np.argsort(times, axis=1, kind="stable")  # NaN sorts last
    entries = np.take_along_axis(times, order, axis=1)
    due = np.searchsorted(clock, entries, side="left")  # first frame with clock >= time
    # One entry a frame: entry j takes max(due_j, frame_{j-1} + 1). With due_j - j in place of
    # due_j that is a running maximum.
    column = np.arange(times.shape[1])
    frame = np.maximum.accumulate(due - column, axis=1) + column if times.shape[1] else due
    executed = (entries > 0) & (frame < len(clock))  # False for NaN
    steps = np.empty(times.shape, np.int64)
    np.put_along_axis(steps, order, np.where(executed, frame, NEVER), axis=1)
    return steps


def _in_advance_steps(times: npt.NDArray[np.floating[Any]], fps: int) -> npt.NDArray[np.int64]:
    """Rule "in_advance" for (B, S) float32 or float64 seconds."""
    if fps % DECISIONS_PER_SECOND:
        raise ValueError(f"fps: expected a multiple of {DECISIONS_PER_SECOND} for rule 'in_advance', got {fps}")
    # np.round(times, 1) is rint(times * 10) / 10 in the type of `times`; the integer is the instant.
    bounded = np.minimum(times, times.dtype.type(TIME_LIMIT + 1))  # keeps the product finite
    tenths = np.rint(bounded * times.dtype.type(DECISIONS_PER_SECOND))
    last = int(TIME_LIMIT * DECISIONS_PER_SECOND) - 1
    valid = (tenths >= 1) & (tenths <= last)  # False for NaN
    instant = np.where(valid, tenths, NEVER).astype(np.int64)
    # A column is lost if an earlier column of its row has the same instant.
    same = instant[:, :, None] == instant[:, None, :]
    lost = np.tril(same, k=-1).any(axis=2)
    return np.where(valid & ~lost, instant * (fps // DECISIONS_PER_SECOND), NEVER)


def parse_plan(words: Sequence[str], scene: Scene) -> npt.NDArray[np.float64]:
    """Read a plan as people write it: a time for each eliminable block, or "never" or "-" for one that stays.

    Args:
        words: times in seconds, in the order of the scene's eliminable blocks; blocks without a word stay.
        scene: the scene to play.

    Returns:
        (1, S) float64, s, as `plan_to_steps` takes them; NaN for a block that stays.

    Raises:
        ValueError: one line; a word is not a time, or there are more words than eliminable blocks.
    """
    blocks = len(scene.eliminable_blocks)
    if len(words) > blocks:
        raise ValueError(f"plan: expected at most {blocks} times (eliminable blocks of {scene.name}), got {len(words)}")
    seconds = np.full((1, blocks), np.nan)
    for k, word in enumerate(words):
        try:
            seconds[0, k] = np.nan if word in NEVER_WORDS else float(word)
        except ValueError:
            seconds[0, k] = -1.0
        if seconds[0, k] < 0 or np.isinf(seconds[0, k]):
            raise ValueError(f"plan: expected seconds from 0 on, or never, separated by spaces, got {word!r}")
    return seconds

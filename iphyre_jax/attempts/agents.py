"""Agents that learn nothing: one that does nothing, random plans, and one that changes its best attempt so far."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.rules import DECISIONS_PER_SECOND, GOAL_Y
from iphyre_jax.scenes import Scene

Floats = npt.NDArray[np.float64]

INSTANTS: Final = 70  # 0, 0.1, ..., 6.9 s, of the official distribution
STAYS: Final = 0.2  # probability that a drawn time becomes 0, which leaves the block
REPEATED: Final = 0.5  # probability that the climber changes its best attempt instead of drawing a new plan
MOVED: Final = 0.5  # s, standard deviation of the changes


def random_plans(rng: np.random.Generator, blocks: int, count: int) -> Floats:
    """Draw plans of the official data sets' distribution, (count, blocks) s, NaN for never.

    Different instants of 0, 0.1, ..., 6.9 s; each becomes 0 with a probability of 0.2; 0 leaves the block.
    """
    order = rng.permuted(np.tile(np.arange(INSTANTS), (count, 1)), axis=1)[:, :blocks]
    stays = (order == 0) | (rng.random((count, blocks)) < STAYS)
    return np.where(stays, np.nan, order / DECISIONS_PER_SECOND)


def unrepeated(plans: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.bool_]:
    """Return which of plans (N, S) s no earlier one equals, (N,); NaN, for never, equals NaN."""
    _, first = np.unique(np.nan_to_num(plans, nan=-1.0), axis=0, return_index=True)
    return np.isin(np.arange(len(plans)), first)


def do_nothing(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
    """An agent that removes nothing."""
    del rng, past
    return np.full((k, len(scene.eliminable_blocks)), np.nan)


def draw_randomly(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
    """An agent that draws `random_plans`, each on its own."""
    del past
    return random_plans(rng, len(scene.eliminable_blocks), k)


def improve_best(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
    """An agent that learns from its attempts: every second plan, or so, is its best one with some times changed.

    Blocks that the best one leaves alone are drawn anew, as in `random_plans`, which removes most of them. A solved
    attempt is best by its reward. Among unsolved ones it is the one whose highest ball came lowest. Without
    trajectories nothing tells them apart; then, until one is solved, the agent draws `random_plans`.
    """
    fresh = random_plans(rng, len(scene.eliminable_blocks), k)
    progress = [_progress(scene, attempt) for attempt in past]
    if max(progress, default=0.0) <= 0:
        return fresh
    best = past[int(np.argmax(progress))].times
    moved = best + np.where(rng.random(fresh.shape) < REPEATED, rng.normal(0, MOVED, fresh.shape), 0.0)
    changed = np.where(np.isnan(best) | (rng.random(fresh.shape) < STAYS), fresh, np.maximum(moved, 1 / 60))
    return np.where(rng.random((k, 1)) < REPEATED, changed, fresh)


def _progress(scene: Scene, attempt: Attempt) -> float:
    """How good an attempt was: its reward if solved, else how far the highest ball fell, as a share of the goal."""
    if attempt.success:
        return 1.0 + attempt.reward
    if attempt.poses is None:
        return 0.0
    height = attempt.poses[:, scene.n_blocks :, 1].min(axis=1)  # y points down: the smallest y is highest
    return min(float(np.nanmax(height)) / GOAL_Y, 1.0)

"""Judgements that need no network: always fail, and count the removals."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.scenes import MAX_ELIMINABLE

SURE: Final = 1.0


def planned_removals(dataset: Dataset) -> npt.NDArray[np.int64]:
    """(N,) removals that each plan has, also those after the end: what is known before it is played."""
    return np.asarray((dataset.steps >= 0).sum(axis=1), np.int64)


def best_threshold(count: npt.NDArray[np.int64], label: npt.NDArray[np.bool_]) -> int:
    """The number of removals from which on a plan is judged to solve, with the highest accuracy on these plans."""
    right = [float(np.mean((count >= least) == label)) for least in range(MAX_ELIMINABLE + 2)]
    return int(np.argmax(right))


def always_fail(dataset: Dataset) -> npt.NDArray[np.float64]:
    """(N,) chances of success: none."""
    return np.zeros(len(dataset.game))


def count_rule(learned: Dataset, plays: Dataset) -> npt.NDArray[np.float64]:
    """(N,) chances by one threshold for all games, learned from other plays."""
    least = best_threshold(planned_removals(learned), learned.success)
    return np.where(planned_removals(plays) >= least, SURE, 0.0)


def count_bound(plays: Dataset) -> npt.NDArray[np.float64]:
    """(N,) chances by one threshold a game that is fitted to the judged plays themselves: what counting can reach."""
    count, chance = planned_removals(plays), np.zeros(len(plays.game))
    for game in np.unique(plays.game):
        here = plays.game == game
        chance[here] = np.where(count[here] >= best_threshold(count[here], plays.success[here]), SURE, 0.0)
    return chance

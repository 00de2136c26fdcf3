"""Figures of analyses: rank correlation, shares, means by split."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.intervals import Estimate
from iphyre_jax.scenes.library import GAME_LISTS, PAPER_SPLITS

COLUMNS: Final[Mapping[str, tuple[str, ...]]] = {name: GAME_LISTS[name] for name in (*PAPER_SPLITS, "all")}
"""The paper's splits and all forty games."""

_NORMAL: Final = 1.959963984540054  # 97.5 % quantile of the normal distribution

Floats = npt.NDArray[np.float64]


def by_split(values: Mapping[str, float]) -> dict[str, float]:
    """Return the mean over the games of each split, and over all forty; splits with games missing are left out."""
    return {
        name: float(np.mean([values[game] for game in games]))
        for name, games in COLUMNS.items()
        if set(games) <= set(values)
    }


def ranks(values: npt.ArrayLike) -> Floats:
    """Return the ranks of values (..., N) in the last axis, from 1; equal values share the mean of their ranks."""
    given = np.asarray(values, np.float64)
    one, other = given[..., :, None], given[..., None, :]
    return np.asarray((one > other).sum(axis=-1) + ((one == other).sum(axis=-1) + 1) / 2, np.float64)


def pearson(first: npt.ArrayLike, second: npt.ArrayLike) -> Floats:
    """Return the correlations (...) of series (..., N); 0 if one is constant."""
    one, two = np.asarray(first, np.float64), np.asarray(second, np.float64)
    one, two = one - one.mean(axis=-1, keepdims=True), two - two.mean(axis=-1, keepdims=True)
    scale = np.sqrt((one**2).sum(axis=-1) * (two**2).sum(axis=-1))
    return np.asarray((one * two).sum(axis=-1) / np.where(scale == 0, 1.0, scale), np.float64)


def spearman(first: npt.ArrayLike, second: npt.ArrayLike) -> Floats:
    """Return the rank correlations (...) of series (..., N)."""
    return pearson(ranks(first), ranks(second))


def share(successes: int, trials: int) -> Estimate:
    """Return a share with its 95 % Wilson interval."""
    if not trials:
        return Estimate(math.nan, 0.0, 1.0)
    observed, square = successes / trials, _NORMAL**2 / trials
    middle = (observed + square / 2) / (1 + square)
    half = _NORMAL * math.sqrt(observed * (1 - observed) / trials + square / trials / 4) / (1 + square)
    return Estimate(observed, max(middle - half, 0.0), min(middle + half, 1.0))

"""Figures with their 95 % intervals: the percentile bootstrap over games, agents or pairs of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

LEVEL: Final = 0.95
RESAMPLES: Final = 10_000
_SEED: Final = 0  # of the resamples

Floats = npt.NDArray[np.float64]


class Estimate(NamedTuple):
    """A figure with its interval at LEVEL; its bounds are NaN where nothing tells how wide it is."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} {self.bounds(2)}"

    def bounds(self, digits: int = 0, scale: float = 1.0) -> str:
        """Return the interval in brackets, "[-]" if it is not known."""
        if math.isnan(self.low):
            return "[-]"
        return f"[{scale * self.low:.{digits}f}, {scale * self.high:.{digits}f}]"


def bootstrap(statistic: Callable[..., Any], *series: npt.ArrayLike) -> Estimate:
    """Return a statistic of one or more series of N values, resampled together 10,000 times, always the same ones.

    Args:
        statistic: of arrays (..., N), one for each series; it returns (...).
        *series: (N,) each.
    """
    given = [np.asarray(values, np.float64) for values in series]
    count = len(given[0])
    picked = np.random.default_rng(_SEED).integers(0, count, (RESAMPLES, count))
    low, high = np.quantile(statistic(*(values[picked] for values in given)), [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Estimate(float(statistic(*given)), float(low), float(high))


def mean_interval(values: npt.ArrayLike) -> Estimate:
    """Return the mean of N values with its interval; a single value tells of no spread, so its bounds are NaN."""
    given = np.asarray(values, np.float64)
    if len(given) == 1:
        return Estimate(float(given[0]), math.nan, math.nan)
    return bootstrap(lambda resampled: resampled.mean(axis=-1), given)

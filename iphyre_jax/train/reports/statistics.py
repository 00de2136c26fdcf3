"""Means over seeds with their spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from iphyre_jax.intervals import LEVEL, Estimate


class Summary(NamedTuple):
    """A mean over seeds."""

    mean: float
    low: float  # of the t interval of the mean at LEVEL; nan for a single seed
    high: float
    iqm: float  # mean of the middle half of all scores, games and seeds together
    seeds: int

    @property
    def estimate(self) -> Estimate:
        """The mean with its interval."""
        return Estimate(self.mean, self.low, self.high)


def summary(scores: Sequence[Sequence[float]]) -> Summary:
    """Summarise scores of seeds x games, at least one of each.

    The interval is mean +- t s / sqrt(n), with s of n - 1 degrees of freedom: of so few seeds a percentile bootstrap
    would be too narrow. The interquartile mean is over all scores at once (Agarwal et al. 2021).
    """
    from scipy import stats  # loads slowly, and every command imports this module

    table = np.asarray(scores, np.float64)
    by_seed = table.mean(axis=1)
    mean, half, count = float(by_seed.mean()), float("nan"), len(by_seed)
    if count > 1:
        half = float(stats.t.ppf((1 + LEVEL) / 2, count - 1) * by_seed.std(ddof=1) / np.sqrt(count))
    return Summary(mean, mean - half, mean + half, float(stats.trim_mean(table.ravel(), 0.25)), count)

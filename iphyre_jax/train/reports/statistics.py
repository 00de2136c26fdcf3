"""Means over seeds with their spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy import stats

LEVEL: Final = 0.95
RESAMPLES: Final = 10_000


class Summary(NamedTuple):
    """A mean over seeds."""

    mean: float
    low: float  # of the bootstrap interval of the mean at LEVEL; nan for a single seed
    high: float
    iqm: float  # mean of the middle half of all scores, games and seeds together
    seeds: int


def summary(scores: Sequence[Sequence[float]]) -> Summary:
    """Summarise scores of seeds x games, at least one of each.

    The interval is the percentile bootstrap over seeds, 10 000 resamples of seed 0; the interquartile mean is over all
    scores at once (Agarwal et al. 2021).
    """
    table = np.asarray(scores, np.float64)
    by_seed = table.mean(axis=1)
    low = high = float("nan")
    if len(by_seed) > 1:
        if np.ptp(by_seed) == 0:
            low = high = float(by_seed[0])
        else:
            found = stats.bootstrap(
                (by_seed,),
                np.mean,
                confidence_level=LEVEL,
                n_resamples=RESAMPLES,
                method="percentile",
                rng=np.random.default_rng(0),
            )
            low, high = map(float, found.confidence_interval)
    return Summary(float(by_seed.mean()), low, high, float(stats.trim_mean(table.ravel(), 0.25)), len(by_seed))

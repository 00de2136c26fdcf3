import math

import numpy as np
import pytest
from scipy import stats

from iphyre_jax.analyses.figures import by_split, ranks, share, spearman
from iphyre_jax.intervals import bootstrap
from iphyre_jax.scenes import GAMES


def test_ranks_and_correlation_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    one, two = rng.integers(0, 8, 30), rng.integers(0, 8, 30)  # with ties
    assert ranks(one) == pytest.approx(stats.rankdata(one))
    assert spearman(one, two) == pytest.approx(stats.spearmanr(one, two).statistic)


def test_wilson_interval_agrees_with_scipy() -> None:
    for hits, trials in ((0, 10), (3, 10), (50, 50), (7, 2000)):
        found = share(hits, trials)
        wanted = stats.binomtest(hits, trials).proportion_ci(method="wilson")
        assert (found.low, found.high) == pytest.approx((wanted.low, wanted.high), abs=1e-12)
    assert math.isnan(share(0, 0).value)


def test_interval_of_a_correlation_holds_it() -> None:
    found = bootstrap(spearman, list(range(20)), [*range(10), *range(19, 9, -1)])
    assert found.low < found.value < found.high


def test_means_by_split_leave_out_what_is_missing() -> None:
    values = {game: float(place) for place, game in enumerate(GAMES)}
    assert by_split(values) == {"basic": 4.5, "noisy": 14.5, "compositional": 24.5, "multi_ball": 34.5, "all": 19.5}
    del values[GAMES[0]]
    assert set(by_split(values)) == {"noisy", "compositional", "multi_ball"}

import math

import numpy as np
import pytest

from iphyre_jax.attempts.metrics import (
    auccess,
    best_reward,
    solved_curve,
    solved_curve_of_independent,
)


def test_worked_example() -> None:
    # Two games, two runs, three attempts. First game: solved at once; at the third. Second: at the second; never.
    success = np.array([[[1, 0, 0], [0, 0, 1]], [[0, 1, 1], [0, 0, 0]]], bool)
    curve = solved_curve(success)
    assert curve.tolist() == [[0.5, 0.5, 1.0], [0.0, 0.5, 0.5]]
    # By hand: weights ln 2, ln 3 - ln 2, ln 4 - ln 3, whose sum is ln 4.
    first = (0.5 * math.log(3) + math.log(4) - math.log(3)) / math.log(4)
    second = 0.5 * (math.log(4) - math.log(2)) / math.log(4)
    assert auccess(curve) == pytest.approx([first, second])
    assert second == 0.25


def test_auccess_of_always_and_never() -> None:
    assert auccess(np.ones(100)) == pytest.approx(1)
    assert auccess(np.zeros(5)) == 0


def test_later_success_counts_less() -> None:
    at = [float(auccess(np.arange(5) >= k)) for k in range(5)]
    assert at == sorted(at, reverse=True)
    assert at[4] == pytest.approx((math.log(6) - math.log(5)) / math.log(6))


def test_independent_attempts_by_hand() -> None:
    # Four plays, one success: of three drawn without putting back, 1/4, 2/4, 3/4 hold it.
    assert solved_curve_of_independent([1, 0, 4], 4, 3) == pytest.approx(
        np.array([[0.25, 0.5, 0.75], [0, 0, 0], [1, 1, 1]])
    )


def test_independent_attempts_agree_with_runs() -> None:
    success = np.random.default_rng(0).random((3, 4000, 5)) < np.array([0.05, 0.3, 0.8])[:, None, None]
    by_runs = solved_curve(success)
    assert solved_curve_of_independent(success.sum(axis=(1, 2)), 20_000, 5) == pytest.approx(by_runs, abs=0.03)


def test_more_attempts_than_plays_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^played: expected a whole number of at least 5, got 4$"):
        solved_curve_of_independent([1], 4, 5)
    for solved in (-1, 11):
        with pytest.raises(ValueError, match=rf"^solved: expected 0 to 10 plays, got {solved}$"):
            solved_curve_of_independent([3, solved], 10, 5)


def test_best_reward_never_falls() -> None:
    reward = np.array([[[-10.0, 970.0, 0.0], [960.0, -20.0, 980.0]]])
    assert best_reward(reward).tolist() == [[475.0, 965.0, 975.0]]

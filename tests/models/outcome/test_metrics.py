"""Measures of outcome classifiers against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from iphyre_jax.models.outcome import metrics

GAME = np.array([0, 0, 0, 0, 1, 1, 1], np.int32)
LABEL = np.array([1, 1, 0, 0, 1, 0, 0], bool)
CHANCE = np.array([0.9, 0.3, 0.4, 0.1, 0.5, 0.5, 0.2])


def test_scores_by_hand() -> None:
    found = metrics.scores(GAME, LABEL, CHANCE)
    assert found.accuracy == pytest.approx(5 / 7)
    assert found.recall_solved == pytest.approx(2 / 3)
    assert found.recall_failed == pytest.approx(3 / 4)
    assert found.balanced == pytest.approx(17 / 24)
    # Game 0: of four pairs 0.3 < 0.4 alone is wrong. Game 1: one right, one tie.
    assert found.auroc == pytest.approx((3 / 4 + 3 / 4) / 2)
    assert found.brier == pytest.approx((0.01 + 0.49 + 0.16 + 0.01 + 0.25 + 0.25 + 0.04) / 7)


def test_auroc_is_within_games() -> None:
    game, label = np.array([0, 0, 1, 1], np.int32), np.array([True, False, True, False])
    chance = np.array([0.9, 0.8, 0.2, 0.3])  # knows that game 0 is easier, and one pair of two
    assert metrics.auroc_within(game, label, chance) == pytest.approx(0.5)
    assert metrics.auroc(label, chance) == pytest.approx(0.5)
    assert np.isnan(metrics.auroc(np.array([True, True]), np.array([0.1, 0.2])))
    only_one_game = metrics.auroc_within(np.array([0, 0, 1], np.int32), np.array([True, False, True]), chance[:3])
    assert only_one_game == pytest.approx(1.0)


def test_reliability_bins() -> None:
    found = metrics.reliability(LABEL, CHANCE)
    assert found.plans.tolist() == [0, 1, 1, 1, 1, 2, 0, 0, 0, 1]
    assert found.chance[5] == pytest.approx(0.5)
    assert found.solved[5] == pytest.approx(0.5)
    assert np.isnan(found.solved[0])
    assert metrics.reliability(np.array([True]), np.array([1.0])).plans[-1] == 1


def test_natural_rates() -> None:
    # Game 0: recalls 1/2 and 1; game 1: 1 and 1/2.
    found, constant = metrics.natural_accuracy(GAME, LABEL, CHANCE, np.array([0.2, 0.6]))
    assert found == pytest.approx((0.2 * 0.5 + 0.8 + 0.6 + 0.4 * 0.5) / 2)
    assert constant == pytest.approx((0.8 + 0.6) / 2)


def test_chances_at_another_rate() -> None:
    moved = metrics.at_rate(np.array([0.5, 0.8, 0.0, 1.0]), 0.2)
    assert moved == pytest.approx([0.2, 0.5, 0.0, 1.0], abs=1e-9)


def test_interval_over_games_skips_games_without_plans() -> None:
    assert metrics.games_interval(np.array([0.5, np.nan, 0.5])) == (0.5, 0.5)
    low, high = metrics.games_interval(np.array([0.0, 1.0]))
    assert (low, high) == (0.0, 1.0)

"""Imagination: which plan is tried, what is learned from a try, the same plans for every N, and the fit to people."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import load_scene, simulate
from iphyre_jax.analyses.imagination import choice, imagined, people_model
from iphyre_jax.analyses.imagination.imagined import Imagination
from iphyre_jax.attempts.agents import unrepeated
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import GAMES

GOOD, BAD = 970.0, -30.0


def different(real: np.ndarray) -> imagined.RealRewards:
    """Plans that do not repeat."""
    return imagined.RealRewards(real, np.ones(real.shape, bool))


def test_the_best_imagined_plan_is_tried_first_and_none_twice() -> None:
    believed = np.array([[BAD, GOOD, GOOD + 5, BAD, BAD], [BAD, GOOD, GOOD + 5, BAD, BAD + 1]])
    real = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    assert choice.tried(believed, real, learning=False).tolist() == [3, 2, 5, 1, 4]


def test_a_simulator_that_was_wrong_is_trusted_less() -> None:
    """Two simulators: the first likes plan 0, then 1; the second likes 2. Plan 0 fails."""
    believed = np.array([[GOOD + 9, GOOD + 8, BAD, BAD, BAD], [BAD, BAD, GOOD, BAD, BAD]])
    real = np.array([BAD, BAD, GOOD, BAD, BAD])
    blind, learned = (choice.tried(believed, real, learning) for learning in (False, True))
    assert blind.tolist()[:3] == [BAD, BAD, GOOD]
    assert learned.tolist()[:2] == [BAD, GOOD]
    best = choice.best_after(believed[None], different(real[None]), plans=5, learning=True)
    np.testing.assert_array_equal(best, [[BAD, GOOD, GOOD, GOOD, GOOD]])


def test_a_plan_that_was_drawn_again_is_not_tried_again() -> None:
    believed = np.array([[[9.0, 9, 9, 2, 1, 0]]])
    played = imagined.RealRewards(np.array([[1.0, 1, 1, 2, 3, 4]]), np.array([[True, False, False, True, True, True]]))
    assert choice.best_after(believed, played, plans=6).tolist() == [[1, 2, 3, 4, 4]]
    assert choice.best_after(believed, played, plans=4).tolist() == [[1, 2, 2, 2, 2]]


def test_fewer_plans_are_the_first_of_more() -> None:
    believed = np.array([[[1.0, 2, 3, 4, 5, 1000]]])
    real = different(np.array([[1.0, 2, 3, 4, 5, 6]]))
    assert choice.best_after(believed, real, plans=5)[0, 0] == 5
    assert choice.best_after(believed, real, plans=6)[0, 0] == 6


@pytest.mark.slow
def test_rows_are_what_the_simulator_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imagined, "PLANS", 12)
    how = Imagination(0.0, draws=2)
    believed, played = imagined.imagined(tmp_path, "hole", how), imagined.real(tmp_path, "hole", "random", 2)
    ends = played.reward
    assert believed.shape == (2, 1, 12)
    assert ends.shape == (2, 12)
    plans = imagined.proposed("hole", 1, "random")
    assert played.unrepeated[1].tolist() == unrepeated(plans).tolist()
    assert not np.array_equal(plans, imagined.proposed("hole", 0, "random"))
    found = simulate("hole", plan_to_steps(plans, 60, "simulate"), fps=60, dtype="float64").reward
    np.testing.assert_allclose(ends[1], found, atol=5e-4)
    wrong = Imagination(30.0, draws=1)
    moved = imagined.imagined(tmp_path, "hole", wrong)
    assert moved.shape == (1, imagined.COPIES, 12)
    assert len({tuple(row) for row in moved[0].tolist()}) > 1  # each copy is displaced on its own
    monkeypatch.setattr(imagined, "COPIES", 3)
    np.testing.assert_array_equal(imagined.imagined(tmp_path / "fewer", "hole", wrong), moved[:, :3])
    with pytest.raises(ValueError, match="settings: expected"):
        imagined.imagined(tmp_path, "hole", Imagination(0.0, draws=1))


@pytest.mark.slow
def test_the_policy_proposes_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imagined, "PLANS", 10)
    mixed, plain = (imagined.proposed("support", 0, kind) for kind in ("policy", "random"))
    assert mixed.shape == (10, len(load_scene("support").eliminable_blocks))
    different = [not np.array_equal(one, two, equal_nan=True) for one, two in zip(mixed, plain, strict=True)]
    assert 1 <= sum(different) <= 7
    assert np.nanmin(mixed) > 0


def test_the_fit_finds_the_setting_that_made_the_scores() -> None:
    rng = np.random.default_rng(0)
    true = {game: float(rng.uniform(200, 980)) for game in GAMES}
    noise = {game: float(rng.uniform(200, 980)) for game in GAMES}
    shares = {game: float(rng.uniform(0, 0.5)) for game in GAMES}
    found = people_model.fit(true, {(2.0, 100): true, (5.0, 100): noise}, shares)
    assert found.chosen == {(2.0, 100): people_model.HALVES}
    assert found.planner.rank.value == pytest.approx(1)
    assert found.planner.error.value == pytest.approx(0)
    assert (found.better_rank, found.better_error) == (1, 1)
    assert abs(found.rival.rank.value) < 0.5

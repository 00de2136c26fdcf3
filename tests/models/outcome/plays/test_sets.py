"""Plays to learn from and plays to judge by: no plan in both, no outcome in a plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.models.outcome import baselines
from iphyre_jax.models.outcome.plays import augmented, sets
from iphyre_jax.models.outcome.settings import DataName
from iphyre_jax.plans import plan_to_steps
from tests.models.outcome.made_up import GAMES, made_up


def test_first_and_later_plays_of_a_kind() -> None:
    plays = made_up(30, 0)
    number = sets._kind_number(plays)
    for game in range(3):
        for kind in (False, True):
            found = number[(plays.game == game) & (plays.success == kind)]
            assert found.tolist() == list(range(len(found)))


def test_repeated_plans_are_dropped() -> None:
    plays = made_up(30, 0)
    others = plays.select(np.arange(0, len(plays), 2))
    left = sets.without(plays, others)
    assert not sets.same_plans(left, others).any()
    assert len(left) <= len(plays) // 2
    assert sets.same_plans(others, plays).all()


def test_random_plans_are_those_of_the_official_distribution() -> None:
    plans = augmented.padded_random_plans(3, 20_000, np.random.default_rng(0))
    assert np.isnan(plans[:, 3:]).all()
    there = ~np.isnan(plans[:, :3])
    assert abs(there.mean() - 0.8 * 69 / 70) < 0.005
    times = plans[:, :3][there]
    assert times.min() == 0.1
    assert times.max() == 6.9
    ordered = np.sort(plans[:, :3], axis=1)
    assert not (ordered[:, 1:] == ordered[:, :-1]).any()  # different instants


def test_plans_and_neighbours_go_at_exact_tenths_of_a_second() -> None:
    rng = np.random.default_rng(0)
    plans = augmented.padded_random_plans(4, 500, rng)
    for some in (plans, augmented.neighbours(plans, np.full(500, 4), rng)):
        exact = np.rint(some * 10) / 10
        np.testing.assert_array_equal(plan_to_steps(some, 60, "simulate"), plan_to_steps(exact, 60, "simulate"))


def test_neighbours_differ_little() -> None:
    rng = np.random.default_rng(0)
    plans = augmented.padded_random_plans(4, 500, rng)
    near = augmented.neighbours(plans, np.full(500, 4), rng)
    assert np.isnan(near[:, 4:]).all()
    assert (np.isnan(near) != np.isnan(plans)).sum(axis=1).max() <= 1
    both = ~np.isnan(near) & ~np.isnan(plans)
    assert np.abs(near - plans)[both].max() < augmented.MOVE + 0.051
    assert near[~np.isnan(near)].min() >= 0.1


def test_only_added_blocks_change_their_flag() -> None:
    scenes = augmented.scenes_of("support", 8, 0)
    assert max(scene.n_blocks for scene in scenes) > 2
    assert any(scene.eliminable[2 : scene.n_blocks].any() for scene in scenes)
    for scene in scenes:
        assert scene.eliminable[:2].all()
        assert scene.eliminable.sum() <= 6


def test_data_sets_one_after_the_other() -> None:
    one, two = made_up(3, 0), made_up(3, 1)
    assert len(augmented.joined([one, two]).scenes) == 3
    other = made_up(3, 1)
    other = type(other)(other.scenes[::-1], **other.arrays(), poses=None, manifest=other.manifest)
    both = augmented.joined([one, other])
    assert [both.scenes[k].name for k in both.game] == [
        *(one.scenes[k].name for k in one.game),
        *(other.scenes[k].name for k in other.game),
    ]


def test_counting_rules() -> None:
    count, label = np.array([0, 1, 2, 2, 3]), np.array([False, False, True, False, True])
    assert baselines.best_threshold(count, label) in (2, 3)
    plays = made_up(30, 0)
    assert not baselines.always_fail(plays).any()
    fitted = (baselines.count_bound(plays) > 0.5) == plays.success
    one = (baselines.count_rule(plays, plays) > 0.5) == plays.success
    assert fitted.mean() >= one.mean()


def test_scenes_without_plays_are_left_out() -> None:
    plays = made_up(5, 0)
    part = sets.compact(sets.of_games(plays, ["hinder", "hole"]))
    assert [scene.name for scene in part.scenes] == ["hinder", "hole"]
    assert [part.scenes[k].name for k in part.game] == ["hinder"] * 5 + ["hole"] * 5
    np.testing.assert_array_equal(part.times, plays.times[5:])


@pytest.mark.parametrize("data", ["large", "generated"])
def test_scenes_that_are_held_out_are_not_learned_from(data: DataName, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sets, "HELD_SCENES", 3)  # one scene of the three
    monkeypatch.setattr(sets, "_large", lambda *_: made_up(5, 1))
    monkeypatch.setattr(sets, "augmented", lambda *_: [made_up(20, 2)])
    monkeypatch.setattr(sets, "generated", lambda *_: made_up(30, 3))
    basic = sets.PlaySets(made_up(5, 4), made_up(5, 5), made_up(5, 6))
    learned = sets.learned_plays(basic, data, Path(), Console(quiet=True))
    others = sets.held_out_plays(data, Path(), Console(quiet=True))
    assert {name: len(plays) for name, plays in others.items()} == {sets.VARIED: 20, sets.GENERATED: 30}
    plain = len(sets.without(made_up(5, 1), basic.later, basic.choose))
    assert len(learned) == plain + 2 * 20 + (2 * 30 if data == "generated" else 0)
    names = [learned.scenes[k].name for k in learned.game]
    assert names.count(GAMES[0]) <= 5  # the held-out scene's plays are the plain ones alone
    assert sets.held_out_plays("official", Path(), Console(quiet=True)) == {}

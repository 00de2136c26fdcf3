"""Plays for the ranker: plans as varied as those of policies, at the agents' rate, kept and found again."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.models.outcome import ranker, runs
from iphyre_jax.models.outcome.agent import judge_of, ranking_agent
from iphyre_jax.models.outcome.plays import pool
from iphyre_jax.models.outcome.plays.augmented import scenes_of
from iphyre_jax.models.outcome.plays.inputs import examples
from iphyre_jax.models.outcome.settings import settings
from iphyre_jax.scenes import SPLITS, load_scene

QUIET = Console(quiet=True)
SCENES = [load_scene(game) for game in ("support", "hinder")]
CONFIG = dataclasses.replace(
    settings("ranker"), fps=10, resets=2, epochs=2, draws=64, batch_size=32, plans_per_scene=8, width=16, rounds=1
)


def never(*_: object) -> None:
    pytest.fail("played or trained again")


def test_wide_plans() -> None:
    plans = pool.wide_plans(3, 4000, np.random.default_rng(0))
    assert plans.shape == (4000, 6)
    assert plans.dtype == np.float64  # tenths of a second are exact
    assert np.isnan(plans[:, 3:]).all()
    there = plans[:, :3][~np.isnan(plans[:, :3])]
    assert 0.1 <= there.min() <= 0.15
    assert 14.0 < there.max() < 15.0
    np.testing.assert_array_equal(there, np.round(10 * there) / 10)
    assert 0.25 < np.isnan(plans[:, :3]).mean() < 0.45
    assert 0.05 < (there > 6.9).mean() < 0.2  # the official plans have none


def test_plays_are_those_of_the_environment_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(pool, "pool_scenes", lambda generated: list(generated))
    monkeypatch.setattr(pool, "PART", 1)
    plays = pool.pool_plays(SCENES, CONFIG, tmp_path, QUIET)
    assert [scene.name for scene in plays.scenes] == ["support", "hinder"]
    assert (plays.manifest["fps"], plays.manifest["rule"], plays.manifest["resets"]) == (10, "in_advance", 2)
    assert np.bincount(plays.game).min() >= pool.PLANS
    assert 0 < plays.success.mean() < 1
    kept = plays.steps >= 0
    np.testing.assert_allclose(plays.steps[kept], 10 * plays.times[kept], atol=1e-3)
    lost = ~kept & ~np.isnan(plays.times)  # of equal times the lowest column counts
    assert lost.any()
    seconds = np.asarray(examples(plays, CONFIG).plans.seconds)
    assert (np.count_nonzero(seconds, axis=1) == kept.sum(axis=1)).all()
    monkeypatch.setattr(pool, "collect_scenes", never)
    again = pool.pool_plays(SCENES, CONFIG, tmp_path, QUIET)
    np.testing.assert_array_equal(again.steps, plays.steps)


def test_pool_scenes_have_variations_of_the_basic_games_and_stand_by_topology(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "VARIED", 2)
    scenes = pool.pool_scenes(SCENES)
    varied = {game: len(scenes_of(game, 2, 0)) for game in SPLITS["basic"]}
    assert min(varied.values()) >= 2
    assert len(scenes) == 2 + sum(varied.values()) + len(varied)
    assert {scene.name for scene in SCENES} | set(varied) <= {scene.name for scene in scenes}
    topologies = [pool.topology_of(scene) for scene in scenes]
    changes = sum(one != other for one, other in pairwise(topologies))
    assert changes == len(set(topologies)) - 1


def test_a_ranker_is_trained_once_and_judges(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(pool, "pool_scenes", lambda generated: [scene for scene in generated for _ in range(2)])
    monkeypatch.setattr(ranker, "HELD", 4)
    found = ranker.trained_ranker(tmp_path, SCENES, CONFIG, QUIET)
    assert found.config == CONFIG
    assert found.name == "ranker-10fps"
    assert (tmp_path / "run" / "metrics.csv").read_text().count("\n") == 1 + CONFIG.epochs
    monkeypatch.setattr(runs, "train", never)
    monkeypatch.setattr(pool, "collect_scenes", never)
    again = ranker.trained_ranker(tmp_path, SCENES, CONFIG, QUIET)
    plans = pool.wide_plans(2, 7, np.random.default_rng(1))[:, :2]
    chance = judge_of(found)("support", plans)
    assert chance.shape == (7,)
    assert ((chance > 0) & (chance < 1)).all()
    assert chance.std() > 0
    np.testing.assert_array_equal(judge_of(again)("support", plans), chance)
    np.testing.assert_allclose(judge_of(found)("support", plans[::-1])[::-1], chance, rtol=1e-4)
    assert ranking_agent(found, 50)("hinder", 3, np.random.default_rng(0)).shape == (3, 3)
    with pytest.raises(ValueError, match=r"epochs: expected that of these settings, found another; remove the folder"):
        ranker.trained_ranker(tmp_path, SCENES, dataclasses.replace(CONFIG, epochs=4), QUIET)

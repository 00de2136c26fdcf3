"""Plays of fresh scenes: the plans that a ranker believes in, and what it learns from them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.models.outcome import ranker, runs, storage, training
from iphyre_jax.models.outcome.plays import hard, pool, proposals
from iphyre_jax.models.outcome.plays.inputs import Plans, plan_inputs, scene_inputs
from iphyre_jax.models.outcome.settings import settings
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.storage.pretrained import load_pretrained

QUIET = Console(quiet=True)
SCENES = [load_scene(game) for game in ("support", "hinder", "hole")]
CONFIG = dataclasses.replace(
    settings("ranker"), fps=10, resets=2, epochs=2, draws=64, batch_size=32, plans_per_scene=8, width=16, rounds=1
)


def latest_removal(config: Any, params: Any, scenes: Any, plans: Plans) -> Any:
    """A ranker that believes in late removals."""
    return np.asarray(plans.seconds).max(axis=-1)[None]


def test_what_a_ranker_believes_in_is_played_and_some_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hard, "predict_groups", latest_removal)
    plays = hard.collect_hard(SCENES, CONFIG, None, 0)
    np.testing.assert_array_equal(np.bincount(plays.game), hard.BEST + hard.OTHERS)
    assert (plays.manifest["fps"], plays.manifest["rule"], plays.manifest["resets"]) == (10, "in_advance", 2)
    latest = np.nan_to_num(plays.times).max(axis=1).reshape(len(SCENES), -1)
    assert (latest[:, 0] == 0).all()  # nothing is done
    best, others = latest[:, 1 : hard.BEST], latest[:, hard.BEST :]
    assert (np.diff(best, axis=1) <= 0).all()
    assert (best.min(axis=1) >= others.max(axis=1)).all()
    assert others.std() > 0
    other = hard.collect_hard(SCENES, CONFIG, None, 1)
    assert not np.array_equal(other.times, plays.times, equal_nan=True)


def test_many_scenes_are_judged_as_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "SCENES", 2)  # the last part is smaller
    rng, count = np.random.default_rng(0), 5
    times = np.concatenate([pool.wide_plans(len(scene.eliminable_blocks), count, rng) for scene in SCENES])
    scenes = scene_inputs(SCENES, CONFIG)
    flat = plan_inputs(SCENES, np.repeat(np.arange(3, dtype=np.int32), count), times, CONFIG)
    plans = Plans(*(np.asarray(part).reshape(3, count, -1) for part in flat))
    params = initial(scenes)
    found = training.predict_groups(CONFIG, params, scenes, plans)
    assert found.shape == (1, 3, count)
    for index, scene in enumerate(SCENES):
        alone = training.predict_for(
            CONFIG, params, scene_inputs([scene], CONFIG), Plans(*(part[index] for part in plans))
        )
        np.testing.assert_allclose(found[:, index], alone, rtol=1e-5)
    assert found.std() > 0


def initial(scenes: Any) -> Any:
    """Parameters of a ranker that has learned nothing."""
    plans = Plans(*[np.zeros((1, 12), np.float32)] * 2)
    network = training.network(CONFIG)
    params = jax.jit(network.init)(jax.random.key(0), scenes.rows[:1], plans, scenes, np.zeros(1, np.int32))
    return jax.tree.map(lambda leaf: leaf[None], params)


@pytest.mark.further
def test_a_refinement_goes_on_from_the_ranker_before(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(pool, "pool_scenes", lambda generated: [scene for scene in generated for _ in range(2)])
    monkeypatch.setattr(ranker, "HELD", 3)
    monkeypatch.setattr(ranker, "REFINED_EPOCHS", 1)
    started: list[Any] = []
    train = runs.train

    def spy(folder: Path, config: Any, learned: Any, held: Any, console: Any, params: Any = None) -> Any:
        started.append((params, len(learned), len(learned.scenes)))
        return train(folder, config, learned, held, console, params)

    monkeypatch.setattr(runs, "train", spy)
    plain = ranker.trained_ranker(tmp_path, SCENES[:2], CONFIG, QUIET)
    fresh = [ranker.Refinement(lambda: SCENES)] * 2
    found = ranker.trained_ranker(tmp_path, SCENES[:2], CONFIG, QUIET, fresh)
    assert len(started) == 3
    assert started[0][0] is None
    jax.tree.map(np.testing.assert_array_equal, started[1][0], plain.params)
    middle = ranker.trained_ranker(tmp_path, SCENES[:2], CONFIG, QUIET, fresh[:1])
    jax.tree.map(np.testing.assert_array_equal, started[2][0], middle.params)
    assert started[0][1] < started[1][1] < started[2][1]
    assert [scenes for *_, scenes in started] == [2, 4, 6]  # one in three is held out
    assert found.config == dataclasses.replace(CONFIG, epochs=1, learning_rate=ranker.REFINED_RATE)
    leaves = [jax.tree.leaves(one.params)[0] for one in (plain, middle, found)]
    assert not np.array_equal(leaves[0], leaves[1])
    assert not np.array_equal(leaves[1], leaves[2])
    monkeypatch.setattr(runs, "train", lambda *_: pytest.fail("trained again"))
    fresh = [ranker.Refinement(lambda: pytest.fail("generated again"))] * 2
    again = ranker.trained_ranker(tmp_path, SCENES[:2], CONFIG, QUIET, fresh)
    jax.tree.map(np.testing.assert_array_equal, again.params, found.params)


@pytest.mark.further
def test_refinements_by_policies_learn_from_their_own_plays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """They need the ranker before them, and nothing that it learned from."""
    monkeypatch.setattr(ranker, "HELD", 3)
    monkeypatch.setattr(ranker, "REFINED_EPOCHS", 1)
    monkeypatch.setattr(ranker, "pool_plays", lambda *_: pytest.fail("played random plans"))
    scenes = scene_inputs(SCENES, CONFIG)
    before = storage.OutcomeClassifier("ranker-10fps", ranker.refined(CONFIG), initial(scenes), {})
    storage.FILES.save(ranker.stage_folder(tmp_path, 1), before)
    asked: list[int] = []

    def propose(scenes: Any, count: int, rng: np.random.Generator) -> Any:
        asked.append(count)
        return proposals.random_proposals(scenes, count, rng)

    random, by_policy = (ranker.Refinement(lambda: SCENES, one) for one in (None, propose))
    one = ranker.trained_ranker(tmp_path, SCENES, CONFIG, QUIET, [random, by_policy])
    two = ranker.trained_ranker(tmp_path, SCENES, CONFIG, QUIET, [random, by_policy, by_policy])
    assert asked == [hard.DRAWN] * 2
    each = (hard.BEST + hard.OTHERS) * 2  # of three scenes, one of which is held out
    assert [found.origin["plays"] for found in (one, two)] == [each, 2 * each]


def test_policies_propose_their_greedy_plan_and_samples() -> None:
    policy = load_pretrained("ppo-i-objects")
    loads: list[int] = []
    propose = proposals.proposals_of(lambda: loads.append(1) or [(policy.config, policy.state)] * 2)  # type: ignore[func-returns-value]
    for seed in (0, 0, 1):
        times = propose(SCENES, 40, np.random.default_rng(seed))
        assert times.shape == (3, 40, 6)
        greedy = 15 * policy.greedy(start_observations("in-advance", "official", SCENES))
        np.testing.assert_allclose(np.nan_to_num(times[:, 0]), greedy, atol=1e-5)
        assert (np.isnan(times) == np.isnan(times[:, :1])).all() is np.False_  # samples differ
        assert np.isnan(times[0, :, 2:]).all()  # support has two blocks
        np.testing.assert_allclose(times * 10, np.rint(times * 10), atol=1e-4)
    assert loads == [1]

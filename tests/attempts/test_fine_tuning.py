"""Attempts of policies that learn on the game that they try."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from iphyre_jax.attempts.fine_tuning import FineTuned
from iphyre_jax.train.algos.registry import init
from iphyre_jax.train.ensemble import ensemble
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import preset
from iphyre_jax.train.storage.pretrained import load_pretrained

QUICK = preset(name="quick")


@pytest.mark.slow
def test_from_scratch_it_learns_the_game() -> None:
    learner = FineTuned(QUICK, batch=20, learning_rate=3e-3)
    found = learner.attempts(401, games=["support"], fps=10, resets=2)
    success = found.success[0, 0]
    assert success.shape == (401,)
    assert success[-100:].mean() > success[1:101].mean() + 0.1
    assert found.reward[0, 0, -100:].mean() > found.reward[0, 0, 1:101].mean()


@pytest.mark.slow
def test_pretrained_it_begins_with_the_greedy_plan() -> None:
    policy = load_pretrained("ppo-i-objects")
    games = ("support", "noisy_hole")
    one, two = (
        FineTuned(policy.config, policy.state).attempts(8, games=games, runs=2, fps=10, resets=2) for _ in range(2)
    )
    scores = {game["game"]: game["greedy"]["reward"] for game in policy.scores["games"]}
    np.testing.assert_allclose(one.reward[:, :, 0], [[scores[game]] * 2 for game in games], atol=1e-3)
    np.testing.assert_array_equal(one.reward, two.reward)
    assert not np.array_equal(one.seconds[:, 0], one.seconds[:, 1])  # runs draw other plans
    assert one.games == games


def test_a_policy_that_learned_from_whole_scenes_learns_on_from_plans() -> None:
    assert isinstance(QUICK.learner, PPO)
    by_scenes = replace(QUICK, learner=replace(QUICK.learner, minibatch_of="scenes", minibatches=2))
    by_scenes.check()
    found = FineTuned(by_scenes, batch=2).attempts(4, games=["support"], fps=10, resets=2)
    assert np.isfinite(found.reward).all()


def test_what_cannot_learn_so_is_refused() -> None:
    with pytest.raises(ValueError, match="config: expected ppo or a2c in advance, got 'DQN-O'"):
        FineTuned(preset("dqn", "on-the-fly")).attempts(2, games=["support"])
    with pytest.raises(ValueError, match="batch"):
        FineTuned(replace(QUICK, seed=1), batch=1).attempts(2, games=["support"])
    line = r"^pretrained: expected the state of one policy, with the network of config$"
    wide = replace(QUICK, hidden_sizes=(16,))
    states = [init(config, jax.random.key(seed)) for seed, config in enumerate((QUICK, QUICK, wide))]
    together = ensemble([QUICK, replace(QUICK, seed=1)], states[:2])
    for other in (states[2], together):
        with pytest.raises(ValueError, match=line):
            FineTuned(QUICK, other).attempts(2, games=["support"])

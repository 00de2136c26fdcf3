"""Ensembles: the product of several policies' distributions, in all that takes a state."""

from __future__ import annotations

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.train.algos.actor_critic import ActorCritic
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.ensemble import ensemble
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.settings.run import TrainConfig, preset

CONFIGS = tuple(TrainConfig(games=("support", "hole"), hidden_sizes=(8,), seed=seed) for seed in range(3))
OBS = start_observations("in-advance", "official", CONFIGS[0].games)


def policies(configs: tuple[TrainConfig, ...] = CONFIGS) -> list[object]:
    """States whose distributions differ clearly from one another."""
    states = [init(config, jax.random.key(config.seed)) for config in configs]
    return [
        state._replace(params=jax.tree.map(lambda leaf: leaf + jnp.sin(40 * leaf + 1), state.params))
        for state in states
    ]


def test_an_ensemble_is_the_normalised_product() -> None:
    agent = algorithm(CONFIGS[0])
    assert isinstance(agent, ActorCritic)
    states = policies()
    each = np.array([agent.distribution(state.params, OBS) for state in states], np.float64)
    product = np.exp(each).prod(axis=0) ** (1 / 3)
    product /= product.sum(axis=-1, keepdims=True)
    together = ensemble(CONFIGS, states)
    found = np.exp(np.asarray(agent.distribution(together.params, OBS)))
    np.testing.assert_allclose(found, product, rtol=1e-4, atol=1e-9)
    assert np.abs(product - np.exp(each[0])).max() > 1e-3
    first = agent.greedy(together, OBS)
    np.testing.assert_array_equal(first, agent.greedy(ensemble(CONFIGS, states[::-1]), OBS))


def test_one_policy_keeps_its_bits() -> None:
    agent, state = algorithm(CONFIGS[0]), policies()[0]
    assert isinstance(agent, ActorCritic)
    alone = ensemble(CONFIGS[:1], [state])
    np.testing.assert_array_equal(agent.distribution(alone.params, OBS), agent.distribution(state.params, OBS))


def test_an_ensemble_is_evaluated_like_a_policy() -> None:
    states = policies()
    together, alone = (evaluate(CONFIGS[0], one, CONFIGS[0].games) for one in (ensemble(CONFIGS, states), states[0]))
    assert [game.game for game in together.games] == ["support", "hole"]
    assert together.games != alone.games
    inference = algorithm(CONFIGS[0]).inference_state(ensemble(CONFIGS, states))
    assert evaluate(CONFIGS[0], inference, CONFIGS[0].games) == together


def test_what_cannot_be_one_policy_is_refused() -> None:
    states = policies()
    with pytest.raises(ValueError, match=r"^states: expected one for each of 3 policies, at least one, got 2$"):
        ensemble(CONFIGS, states[:2])
    other = replace(CONFIGS[1], hidden_sizes=(16,))
    with pytest.raises(
        ValueError, match=r"^ensemble: expected policies that differ in their seeds only, got hidden_sizes 16, not 8$"
    ):
        ensemble((CONFIGS[0], other), states[:2])
    with pytest.raises(ValueError, match=re.escape("ensemble: expected ppo or a2c with one of the heads time_grid,")):
        ensemble((preset("sac"),), states[:1])
    with pytest.raises(ValueError, match=r"got ppo with gaussian$"):
        ensemble((replace(CONFIGS[0], head="gaussian"),), states[:1])

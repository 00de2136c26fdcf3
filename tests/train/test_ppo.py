"""The pieces of PPO against hand-worked numbers, and the learner on bandits with known answers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.env import observation_table
from iphyre_jax.train import ppo
from iphyre_jax.train.config import HeadName, TrainConfig
from iphyre_jax.train.distributions import SlotHead

SMALL = TrainConfig(hidden=(32,), updates=40, plans_per_scene=32, learning_rate=3e-3)


def test_advantage_by_hand() -> None:
    """Scene 1: mean 500, deviation 500. Scene 2: all alike. Scene 3: mean 2, deviation 1."""
    reward = jnp.array([[1000.0, 0.0], [-15.0, -15.0], [1.0, 3.0]])
    expected = [[500 / 530, -500 / 530], [0, 0], [-1 / 31, 1 / 31]]
    np.testing.assert_allclose(ppo.scene_advantage(reward, 30.0), expected, rtol=1e-6)


def test_clipped_objective_by_hand() -> None:
    """The better ratio is only rewarded up to 1.2, the worse one only spared down to 0.8."""
    ratio = jnp.array([1.5, 1.5, 0.5, 0.5, 1.1])
    advantage = jnp.array([2.0, -2.0, 2.0, -2.0, 3.0])
    np.testing.assert_allclose(ppo.clipped_objective(ratio, advantage, 0.2), [2.4, -3.0, 1.0, -1.6, 3.3], rtol=1e-6)


def test_only_slots_with_a_block_count() -> None:
    head = SlotHead(never=0.25)
    outputs = jnp.zeros((1, 6, head.outputs))
    choice = jnp.zeros((1, 6), jnp.int32)  # never, everywhere
    mask = jnp.array([[True, True, False, False, False, False]])
    np.testing.assert_allclose(ppo.plan_log_prob(head, outputs, choice, mask), [2 * math.log(0.25)], rtol=1e-5)
    each = float(head.entropy(outputs[0, 0]))
    np.testing.assert_allclose(ppo.mean_entropy(head, outputs, mask), each, rtol=1e-5)


def batch_of(config: TrainConfig, state: ppo.TrainState, advantage: Any) -> ppo.Batch:
    seen = jnp.asarray(np.repeat(observation_table(("support", "hole")), 2, axis=0))
    _, choice, log_prob = ppo.collect(config, state.params, jax.random.key(5), seen)
    return ppo.Batch(seen, choice, log_prob, jnp.asarray(advantage))


def test_loss_before_the_first_step() -> None:
    """All ratios are 1: the loss is minus the mean advantage, minus the weighted entropy; nothing is clipped."""
    state = ppo.init(SMALL)
    batch = batch_of(SMALL, state, [1.0, -0.5, 2.0, 0.0])
    value, metrics = ppo.loss(state.params, SMALL, batch, jnp.float32(0.0))
    np.testing.assert_allclose(value, -0.625, rtol=1e-5)
    np.testing.assert_allclose(metrics.kl, 0.0, atol=1e-6)
    np.testing.assert_allclose(metrics.clipped, 0.0)
    weighted, _ = ppo.loss(state.params, SMALL, batch, jnp.float32(0.5))
    np.testing.assert_allclose(weighted, -0.625 - 0.5 * float(metrics.entropy), rtol=1e-5)


def test_loss_of_another_policy_by_hand() -> None:
    """Plans that were half as probable when they were sampled: ratio 2, beyond the clip range."""
    state = ppo.init(SMALL)
    batch = batch_of(SMALL, state, [1.0, 1.0, -1.0, -1.0])
    batch = batch._replace(log_prob=batch.log_prob - math.log(2))
    value, metrics = ppo.loss(state.params, SMALL, batch, jnp.float32(0.0))
    np.testing.assert_allclose(value, -(1.2 + 1.2 - 2.0 - 2.0) / 4, rtol=1e-4)
    np.testing.assert_allclose(metrics.kl, 2 - 1 - math.log(2), rtol=1e-4)
    np.testing.assert_allclose(metrics.clipped, 1.0)


def test_learning_raises_what_paid() -> None:
    state = ppo.init(SMALL)
    batch = batch_of(SMALL, state, [1.0, -1.0, 1.0, -1.0])
    after, metrics = ppo.learn(SMALL, state, batch)
    mask = ppo.candidate_mask(batch.observation)
    outputs = ppo.policy(SMALL, after.params, batch.observation)
    change = ppo.plan_log_prob(SlotHead(), outputs, batch.choice, mask) - batch.log_prob
    assert bool((change * batch.advantage > 0).all())
    assert int(after.update) == 1
    assert float(metrics.grad_norm) > 0


def test_entropy_weight_falls_to_zero() -> None:
    """In the last round but none the bonus is gone: with no advantage nothing moves."""
    config = TrainConfig(hidden=(8,), updates=2, entropy=0.5)
    state = ppo.init(config)
    batch = batch_of(config, state, [0.0] * 4)
    last, _ = ppo.learn(config, state._replace(update=jnp.int32(2)), batch)
    first, _ = ppo.learn(config, state, batch)
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), last.params, state.params)
    assert max(jax.tree.leaves(moved)) == 0
    moved = jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), first.params, state.params)
    assert max(jax.tree.leaves(moved)) > 0


def test_the_same_seed_gives_the_same_bits() -> None:
    states = []
    for _ in range(2):
        state = ppo.init(SMALL)
        states.append(ppo.learn(SMALL, state, batch_of(SMALL, state, [1.0, -1.0, 0.5, 0.0]))[0])
    for a, b in zip(jax.tree.leaves(states[0].params), jax.tree.leaves(states[1].params), strict=True):
        np.testing.assert_array_equal(a, b)


def solve(config: TrainConfig, games: tuple[str, ...], reward: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Any:
    """Learn a bandit whose reward is a function of (scene (B,), seconds (B, 6)); greedy seconds per scene."""
    table = observation_table(games)
    which = np.repeat(np.arange(len(games)), config.plans_per_scene)
    seen = jnp.asarray(table[which])
    state = ppo.init(config)
    for _ in range(config.updates):
        key, plan_key = jax.random.split(state.key)
        actions, choice, log_prob = ppo.collect(config, state.params, plan_key, seen)
        paid = jnp.asarray(reward(which, 15 * np.asarray(actions)), jnp.float32).reshape(len(games), -1)
        advantage = ppo.scene_advantage(paid, config.std_floor).reshape(-1)
        state, _ = ppo.learn(config, state._replace(key=key), ppo.Batch(seen, choice, log_prob, advantage))
    return 15 * np.asarray(ppo.greedy(config, state.params, jnp.asarray(table)))


@pytest.mark.parametrize("head", ["slots", "gaussian"])
def test_bandit_action_decides(head: HeadName) -> None:
    """One scene; block 0 must go between 3 and 5 s, whatever block 1 does."""
    config = TrainConfig(hidden=(32,), updates=40, plans_per_scene=64, learning_rate=3e-3, head=head)
    seconds = solve(config, ("support",), lambda _, t: 1000.0 * ((t[:, 0] > 3) & (t[:, 0] < 5)))
    assert 3 < seconds[0, 0] < 5


@pytest.mark.parametrize("head", ["slots", "gaussian"])
def test_bandit_observation_decides(head: HeadName) -> None:
    """Two scenes with opposite answers: early in one, late in the other."""
    config = TrainConfig(hidden=(32,), updates=60, plans_per_scene=64, learning_rate=3e-3, head=head)

    def reward(scene: np.ndarray, t: np.ndarray) -> np.ndarray:
        return 1000.0 * np.where(scene == 0, (t[:, 0] > 0.5) & (t[:, 0] < 3), t[:, 0] > 7)

    seconds = solve(config, ("support", "spring"), reward)
    assert 0.5 < seconds[0, 0] < 3
    assert seconds[1, 0] > 7


def test_bandit_never_pays() -> None:
    """Every removal costs 10 and nothing succeeds: the best plan removes nothing."""
    config = TrainConfig(hidden=(32,), updates=60, plans_per_scene=64, learning_rate=3e-3)
    seconds = solve(config, ("seesaw",), lambda _, t: -15 - 10.0 * (t[:, :2] > 0).sum(axis=1))
    np.testing.assert_array_equal(seconds[0, :2], [0, 0])


def test_bandit_small_differences_count_within_a_scene() -> None:
    """One scene pays 1000, the other never does: a difference of 10 in the first is still learned."""
    config = TrainConfig(hidden=(32,), updates=60, plans_per_scene=64, learning_rate=3e-3)

    def reward(scene: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.where(scene == 0, 1000.0 - 10 * (t[:, 1] > 0), -15.0)

    assert solve(config, ("support", "seesaw"), reward)[0, 1] == 0

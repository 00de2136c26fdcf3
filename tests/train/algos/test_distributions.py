"""Action heads against their formulae."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.envs.in_advance import action_to_times
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import FRAMES
from iphyre_jax.train.algos.distributions import (
    HEADS,
    CategoricalHead,
    DeterministicHead,
    GaussianHead,
    TanhNormalHead,
    TimeGridHead,
    action_head,
    distinct_instants,
)
from iphyre_jax.train.settings.agents import HeadName

ALL = jnp.ones(6, bool)
TWO = jnp.array([True, True, False, False, False, False])
SAMPLED = ("time_grid", "gaussian", "tanh_normal", "categorical", "uniform")


def of_slot_0(values: list[float], width: int) -> jax.Array:
    """(6, width) outputs, those of slot 0 given first."""
    return jnp.zeros((6, width)).at[0, : len(values)].set(jnp.array(values))


def test_slot_head_starts_at_its_prior() -> None:
    head = TimeGridHead(never=0.25, scale=4.0)
    raw_actions = jnp.tile(jnp.arange(FRAMES)[:, None], (1, 6))
    only = jnp.zeros((FRAMES, 6), bool).at[:, 0].set(True)
    probability = np.exp(head.log_prob(head.distribution(jnp.zeros((FRAMES, *head.shape)), only), raw_actions, only))
    weight = np.exp(-np.arange(1, FRAMES) / 10 / 4.0)
    np.testing.assert_allclose(probability[0], 0.25, rtol=1e-5)
    np.testing.assert_allclose(probability[1:], 0.75 * weight / weight.sum(), rtol=1e-4)


def test_slot_entropy_by_hand() -> None:
    """Two instants are left with half the mass each, in every slot: ln 2 a slot."""
    head = TimeGridHead()
    outputs = jnp.full(head.shape, -60.0) - head._log_prior()[None]
    outputs = outputs.at[:, 3].add(60.0).at[:, 7].add(60.0)
    distribution = head.distribution(outputs, ALL)
    np.testing.assert_allclose(head.entropy(distribution, ALL), math.log(2), rtol=1e-5)
    np.testing.assert_allclose(head.log_prob(distribution, jnp.full(6, 7), ALL), -6 * math.log(2), rtol=1e-5)


def test_only_slots_with_a_block_count() -> None:
    head = TimeGridHead(never=0.25)
    distribution, never = head.distribution(jnp.zeros(head.shape), TWO), jnp.zeros(6, jnp.int32)
    np.testing.assert_allclose(head.log_prob(distribution, never, TWO), 2 * math.log(0.25), rtol=1e-5)
    np.testing.assert_allclose(head.entropy(distribution, TWO), head.entropy(distribution, ALL), rtol=1e-5)


def test_every_slot_is_its_own_instant() -> None:
    """Choice k is played before decision k, 0 never: the whole way through action, seconds and rounding."""
    raw_actions = jnp.zeros((FRAMES, 6), jnp.int32).at[:, 0].set(jnp.arange(FRAMES))
    actions = np.asarray(TimeGridHead().action(raw_actions))
    steps = plan_to_steps(action_to_times(actions), 10, "in_advance")[:, 0]
    np.testing.assert_array_equal(steps, [-1, *range(1, FRAMES)])


def test_blocks_of_one_instant_go_one_after_the_other() -> None:
    """None is lost but those put off beyond the last instant, 149; "never" is put off for nothing."""
    raw_actions = jnp.array(
        [[5, 5, 6, 0, 0, 5], [149, 149, 0, 1, 1, 1], [3, 1, 2, 6, 5, 4], [149, 149, 148, 0, 149, 149]]
    )
    expected = [[5, 6, 7, 0, 0, 8], [149, 150, 0, 1, 2, 3], [3, 1, 2, 6, 5, 4], [149, 150, 148, 0, 150, 150]]
    np.testing.assert_array_equal(distinct_instants(raw_actions), expected)
    steps = plan_to_steps(action_to_times(np.asarray(TimeGridHead().action(raw_actions))), 10, "in_advance")
    np.testing.assert_array_equal(
        steps, [[5, 6, 7, -1, -1, 8], [149, -1, -1, 1, 2, 3], [3, 1, 2, 6, 5, 4], [149, -1, 148, -1, -1, -1]]
    )


def test_gaussian_by_hand() -> None:
    head = GaussianHead()
    distribution = head.distribution(of_slot_0([1.0, math.log(0.5)], 2), ALL)  # slot 0: mean 1, deviation 0.5
    raw_action, only = jnp.zeros(6).at[0].set(2.0), jnp.zeros(6, bool).at[0].set(True)
    expected = -0.5 * 4.0 - math.log(0.5) - 0.5 * math.log(2 * math.pi)  # two deviations away
    np.testing.assert_allclose(head.log_prob(distribution, raw_action, only), expected, rtol=1e-6)
    np.testing.assert_allclose(head.entropy(distribution, only), 0.5 * math.log(2 * math.pi * math.e * 0.25), rtol=1e-6)
    np.testing.assert_allclose(head.mode(distribution), [1, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(head.action(jnp.array([-3.0, -1.0, 0.0, 1.0, 2.0])), [0, 0, 0.5, 1, 1])


def test_squashed_by_hand() -> None:
    """At u = 1 the density of tanh u is that of u divided by 1 - tanh^2 1; the box is never left."""
    head = TanhNormalHead()
    distribution, only = head.distribution(of_slot_0([1.0, 0.0], 2), ALL), jnp.zeros(6, bool).at[0].set(True)
    expected = -0.5 * math.log(2 * math.pi) - math.log(1 - math.tanh(1) ** 2)
    np.testing.assert_allclose(head.log_prob(distribution, jnp.ones(6), only), expected, rtol=1e-5)
    np.testing.assert_allclose(head.action(jnp.array([-99.0, 0.0, 1.0])), [0, 0.5, (math.tanh(1) + 1) / 2], rtol=1e-6)


def test_categorical_starts_at_its_prior() -> None:
    """Two blocks share what doing nothing leaves; slots without a block are never chosen."""
    head = CategoricalHead(no_op_prob=0.9)
    outputs = jnp.zeros(7)
    distribution = head.distribution(outputs, TWO)
    np.testing.assert_allclose(np.exp(distribution), [0.9, 0.05, 0.05, 0, 0, 0, 0], rtol=1e-5)
    nats = -0.9 * math.log(0.9) - 0.1 * math.log(0.05)
    np.testing.assert_allclose(head.entropy(distribution, TWO), nats, rtol=1e-5)
    assert int(head.mode(head.distribution(outputs.at[5].set(50.0), TWO))) == 0


def test_the_uniform_head_offers_all_seven_actions() -> None:
    """As the official environments do: a slot without a block can be chosen."""
    head = HEADS["uniform"]
    assert isinstance(head, CategoricalHead)
    distribution = head.distribution(jnp.zeros(7), TWO)
    np.testing.assert_allclose(np.exp(distribution), np.full(7, 1 / 7), rtol=1e-5)
    assert int(head.mode(head.distribution(jnp.zeros(7).at[5].set(50.0), TWO))) == 5
    np.testing.assert_array_equal(head.offered(TWO), np.ones(7, bool))
    np.testing.assert_array_equal(CategoricalHead().offered(TWO), [1, 1, 1, 0, 0, 0, 0])


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLED)
def test_samples_follow_the_distribution(name: HeadName) -> None:
    """The mean of -log p over samples is the entropy, and samples act in the box."""
    head = action_head(name)

    @jax.jit  # one program, not one for each operation
    def drawn() -> tuple[jax.Array, jax.Array, jax.Array]:
        outputs = jax.random.normal(jax.random.key(0), head.shape) * 0.5
        distribution, mask = head.distribution(outputs, TWO), jnp.broadcast_to(TWO, (20_000, 6))
        many = jnp.broadcast_to(distribution[None], (20_000, *head.shape))
        raw_action = head.sample(jax.random.key(1), many)
        entropy = jnp.zeros(()) if name == "tanh_normal" else head.entropy(distribution, TWO)  # it has no formula
        return -head.log_prob(many, raw_action, mask).mean(), entropy, head.action(raw_action)

    nats, entropy, action = drawn()
    if name != "tanh_normal":
        np.testing.assert_allclose(nats, (2 if len(head.shape) == 2 else 1) * entropy, rtol=0.03)
    assert float(action.min()) >= 0
    assert float(action.max()) <= (1 if len(head.shape) == 2 else 6 if name == "uniform" else 2)


@pytest.mark.parametrize("name", SAMPLED)
def test_the_mode_is_the_most_probable_choice(name: HeadName) -> None:
    head = action_head(name)
    normal = GaussianHead() if name == "tanh_normal" else head  # the mode of u; tanh moves that of the density

    @jax.jit
    def compared() -> tuple[jax.Array, jax.Array]:
        outputs = jax.random.normal(jax.random.key(3), (50, *head.shape))
        mask = jnp.broadcast_to(TWO, (50, 6))
        distribution = head.distribution(outputs, mask)
        mode, other = head.mode(distribution), head.sample(jax.random.key(4), distribution)
        return normal.log_prob(distribution, mode, mask), normal.log_prob(distribution, other, mask)

    best, other = compared()
    assert bool((best >= other).all())


def test_heads_by_name() -> None:
    assert isinstance(action_head("time_grid"), TimeGridHead)
    assert isinstance(HEADS["deterministic"], DeterministicHead)
    with pytest.raises(ValueError, match="head: expected one that can be sampled, got 'deterministic'"):
        action_head("deterministic")

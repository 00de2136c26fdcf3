"""Action heads against their formulae."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.env import action_to_times
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.train.distributions import SLOTS, ActionHead, GaussianHead, SlotHead, action_head

HEADS = (SlotHead(), GaussianHead())


def test_slot_head_starts_at_its_prior() -> None:
    head = SlotHead(never=0.25, scale=4.0)
    choices = jnp.arange(SLOTS)
    probability = np.exp(head.log_prob(jnp.zeros((SLOTS, SLOTS)), choices))
    weight = np.exp(-np.arange(1, SLOTS) / 10 / 4.0)
    np.testing.assert_allclose(probability[0], 0.25, rtol=1e-5)
    np.testing.assert_allclose(probability[1:], 0.75 * weight / weight.sum(), rtol=1e-4)


def test_slot_entropy_by_hand() -> None:
    """Two slots are left with half the mass each: ln 2."""
    head = SlotHead()
    outputs = jnp.full((1, SLOTS), -60.0) - head._log_prior()[None]
    outputs = outputs.at[0, 3].add(60.0).at[0, 7].add(60.0)
    np.testing.assert_allclose(head.entropy(outputs), [math.log(2)], rtol=1e-5)
    np.testing.assert_allclose(head.log_prob(outputs, jnp.array([7])), [-math.log(2)], rtol=1e-5)


def test_every_slot_is_its_own_instant() -> None:
    """Choice k is played before decision k, 0 never: the whole way through action, seconds and rounding."""
    actions = np.zeros((SLOTS, 6), np.float32)
    actions[:, 0] = SlotHead().action(jnp.arange(SLOTS))
    steps = plan_to_steps(action_to_times(actions), 10, "in_advance")[:, 0]
    np.testing.assert_array_equal(steps, [-1, *range(1, SLOTS)])


def test_gaussian_by_hand() -> None:
    head = GaussianHead()
    outputs = jnp.array([[1.0, math.log(0.5)]])  # mean 1, deviation 0.5
    expected = -0.5 * 4.0 - math.log(0.5) - 0.5 * math.log(2 * math.pi)  # two deviations away
    np.testing.assert_allclose(head.log_prob(outputs, jnp.array([2.0])), [expected], rtol=1e-6)
    np.testing.assert_allclose(head.entropy(outputs), [0.5 * math.log(2 * math.pi * math.e * 0.25)], rtol=1e-6)
    np.testing.assert_allclose(head.mode(outputs), [1.0])
    np.testing.assert_allclose(head.action(jnp.array([-3.0, -1.0, 0.0, 1.0, 2.0])), [0, 0, 0.5, 1, 1])


@pytest.mark.parametrize("head", HEADS, ids=("slots", "gaussian"))
def test_samples_follow_the_distribution(head: ActionHead) -> None:
    """The mean of -log p over samples is the entropy, and samples act in the box."""
    outputs = jax.random.normal(jax.random.key(0), (6, head.outputs)) * 0.5
    many = jnp.broadcast_to(outputs[None], (20_000, 6, head.outputs))
    choice = head.sample(jax.random.key(1), many)
    np.testing.assert_allclose(-head.log_prob(many, choice).mean(axis=0), head.entropy(outputs), rtol=0.03)
    action = head.action(choice)
    assert action.dtype == jnp.float32
    assert float(action.min()) >= 0
    assert float(action.max()) <= 1


@pytest.mark.parametrize("head", HEADS, ids=("slots", "gaussian"))
def test_the_mode_is_the_most_probable_choice(head: ActionHead) -> None:
    outputs = jax.random.normal(jax.random.key(3), (6, head.outputs))
    mode = head.mode(outputs)
    for key in jax.random.split(jax.random.key(4), 50):
        assert bool((head.log_prob(outputs, mode) >= head.log_prob(outputs, head.sample(key, outputs))).all())


def test_heads_by_name() -> None:
    assert isinstance(action_head("slots"), SlotHead)
    assert isinstance(action_head("gaussian"), GaussianHead)

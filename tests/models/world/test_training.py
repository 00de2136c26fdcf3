"""Sigma learns the size of most errors, from steps that begin where the world really was; rows are picked exactly."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.models.world.networks.objects import Sigma
from iphyre_jax.models.world.networks.pairs import own_rows
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import State
from iphyre_jax.models.world.training import noisy, start, step_loss

MANY = 400


def _state(centre: jax.Array) -> State:
    none = jnp.zeros((MANY, 1))
    return State(centre, none, jnp.zeros((MANY, 1, 2)), none)


@jax.jit
@jax.grad
def _slope(log_sigma: jax.Array, error: jax.Array, certain: jax.Array) -> jax.Array:
    """The slope of the loss over the logarithm of the places' sigma."""
    other = jnp.ones((MANY, 1))
    spread = Sigma(jnp.exp(log_sigma) * other, other, other, other)
    known = jnp.broadcast_to(certain, (MANY, 1))
    return step_loss(_state(error), spread, _state(jnp.zeros_like(error)), jnp.ones((MANY, 1), bool), known)


def test_sigma_is_the_size_of_68_percent_of_errors_whatever_the_tails() -> None:
    error = jax.random.normal(jax.random.key(0), (MANY, 1, 2)).at[::10].mul(30)  # 10 % are outliers
    within = float(jnp.quantile(jnp.abs(error), 0.6827))
    low, high = jnp.log(0.95 * within), jnp.log(1.05 * within)
    assert _slope(low, error, jnp.array(True)) < 0 < _slope(high, error, jnp.array(True))
    assert _slope(low, error, jnp.array(False)) == 0  # the world was not where it was said to be


def test_every_seed_has_its_own_weights() -> None:
    one, two = (start(WorldConfig(seed=seed)).params for seed in (0, 2**32))
    assert any((a != b).any() for a, b in zip(*map(jax.tree.leaves, (one, two)), strict=True))


def test_noise_spares_half_of_the_worlds_and_says_which() -> None:
    state = _state(jnp.zeros((MANY, 1, 2)))
    moved, clean = noisy(WorldConfig(), jax.random.key(1), state)
    still = np.asarray(moved.centre == 0).all(axis=(1, 2))
    np.testing.assert_array_equal(still, np.asarray(clean)[:, 0])
    assert 0.4 < still.mean() < 0.6


def test_rows_are_picked_exactly() -> None:
    table = jax.random.normal(jax.random.key(2), (3, 12, 2)) * 600
    index = jax.random.randint(jax.random.key(3), (3, 2, 4), 0, 12)
    worlds = np.arange(3)[:, None, None]
    np.testing.assert_array_equal(own_rows(table, index), np.asarray(table)[worlds, np.asarray(index)])
    flags = table[..., 0] > 0
    np.testing.assert_array_equal(own_rows(flags, index), np.asarray(flags)[worlds, np.asarray(index)])

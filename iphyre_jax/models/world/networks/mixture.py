"""Mixtures of Gaussians with bounded deviations: their likelihood where numbers can be left out, and their mean."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp

FLOOR: Final = 0.01  # least standard deviation: 6 px, if lengths are divided by 600


class GaussianMixture(NamedTuple):
    """G Gaussians of D independent numbers, any axes in front."""

    logits: jax.Array  # (..., G) of the weights
    mean: jax.Array  # (..., G, D)
    sigma: jax.Array  # (..., G, D)


def bounded_sigma(raw: jax.Array) -> jax.Array:
    """Any number to a standard deviation of at least FLOOR."""
    return jax.nn.softplus(raw) + FLOOR


def log_likelihood(mixture: GaussianMixture, x: jax.Array, counted: jax.Array) -> jax.Array:
    """Logarithm of the density of x, (...).

    Args:
        mixture: of D numbers.
        x: (..., D).
        counted: (..., D) bool; the others are left out, as if they were not predicted.
    """
    apart = (x[..., None, :] - mixture.mean) / mixture.sigma
    each = -jnp.square(apart) / 2 - jnp.log(mixture.sigma) - math.log(2 * math.pi) / 2
    gaussians = jnp.where(counted[..., None, :], each, 0.0).sum(axis=-1)
    return jax.nn.logsumexp(jax.nn.log_softmax(mixture.logits) + gaussians, axis=-1)


def expected(mixture: GaussianMixture) -> jax.Array:
    """The mean, (..., D)."""
    return (jax.nn.softmax(mixture.logits)[..., None] * mixture.mean).sum(axis=-2)

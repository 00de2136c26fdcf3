"""The likelihood of mixtures against scipy, and bounded deviations."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from iphyre_jax.models.world.networks.mixture import FLOOR, GaussianMixture, bounded_sigma, expected, log_likelihood

# Two Gaussians of two numbers, weights 1/4 and 3/4.
MIXTURE = GaussianMixture(
    jnp.log(jnp.array([1.0, 3.0])), jnp.array([[0.0, 1.0], [2.0, -1.0]]), jnp.array([[1.0, 0.5], [2.0, 0.1]])
)
X = jnp.array([1.0, -0.9])


def density(column: int, row: int) -> float:
    return float(stats.norm.pdf(X[column], MIXTURE.mean[row, column], MIXTURE.sigma[row, column]))


def test_likelihood_is_scipys() -> None:
    both = jnp.array([True, True])
    by_hand = np.log(0.25 * density(0, 0) * density(1, 0) + 0.75 * density(0, 1) * density(1, 1))
    assert float(log_likelihood(MIXTURE, X, both)) == pytest.approx(by_hand, rel=1e-5)
    # 3/4 of N(1; 2, 2) N(-0.9; -1, 0.1) = 3/4 * 0.176033 * 2.419707; the first is below 1e-3 of it.
    assert by_hand == pytest.approx(np.log(0.75 * 0.176033 * 2.419707), abs=1e-3)
    assert expected(MIXTURE).tolist() == pytest.approx([1.5, -0.5])


def test_numbers_that_do_not_count_are_left_out() -> None:
    first = jnp.array([True, False])
    by_hand = np.log(0.25 * density(0, 0) + 0.75 * density(0, 1))
    assert float(log_likelihood(MIXTURE, X, first)) == pytest.approx(by_hand, rel=1e-5)
    assert float(log_likelihood(MIXTURE, X.at[1].set(1e6), first)) == pytest.approx(by_hand, rel=1e-5)
    assert float(log_likelihood(MIXTURE, X, ~(first | ~first))) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_constant_numbers_cannot_make_it_unbounded() -> None:
    sigma = bounded_sigma(jnp.array([-1e4, -50.0, 0.0, 50.0]))
    assert sigma.min() == pytest.approx(FLOOR)
    most = -np.log(FLOOR * np.sqrt(2 * np.pi))

    def exact(raw: jax.Array) -> jax.Array:
        one = GaussianMixture(jnp.zeros(1), jnp.zeros((1, 1)), bounded_sigma(raw)[None, None])
        return log_likelihood(one, jnp.zeros(1), jnp.array([True]))

    value, gradient = jax.value_and_grad(exact)(jnp.float32(-1e4))
    assert float(value) == pytest.approx(most, rel=1e-5)
    assert np.isfinite(gradient)

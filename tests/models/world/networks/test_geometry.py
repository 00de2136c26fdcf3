"""Where two objects are nearest, by hand."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.models.world.networks.geometry import FAR, contact


def vector(x: float, y: float) -> jnp.ndarray:
    return jnp.array([x, y])


@pytest.mark.slow
def test_ball_over_a_bar_and_beyond_its_end() -> None:
    bar = vector(100, 200), vector(50, 0), jnp.array(10.0)
    found = contact(vector(120, 165), vector(0, 0), jnp.array(20.0), *bar)
    assert found.gap == pytest.approx(5.0, abs=1e-3)  # 35 px apart, less both radii
    np.testing.assert_allclose(found.normal, [0, -1], atol=1e-5)  # from the bar to the ball: up
    np.testing.assert_allclose(found.arm_i, [0, 20], atol=1e-3)
    np.testing.assert_allclose(found.arm_j, [20, -10], atol=1e-3)
    assert found.second_gap == FAR  # a ball has one nearest place
    beyond = contact(vector(180, 160), vector(0, 0), jnp.array(20.0), *bar)
    assert beyond.gap == pytest.approx(50 - 30, abs=1e-3)  # 30 beside and 40 above the end
    np.testing.assert_allclose(beyond.normal, [0.6, -0.8], atol=1e-5)


def test_a_lying_bar_touches_with_both_ends() -> None:
    found = contact(vector(0, 0), vector(30, 0), jnp.array(10.0), vector(5, 20), vector(90, 0), jnp.array(10.0))
    assert found.gap == pytest.approx(0.0, abs=1e-3)
    assert found.second_gap == pytest.approx(0.0, abs=1e-3)
    assert abs(float(found.arm_i[0])) == pytest.approx(30)
    assert float(found.second_arm[0]) == pytest.approx(-float(found.arm_i[0]))

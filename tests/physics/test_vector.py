"""Plane vectors against complex numbers, and the rounding of every product in float64."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import pytest

from iphyre_jax.physics import vector
from iphyre_jax.physics.vector import Vec

Complex = npt.NDArray[np.complex128]


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


def vec(numbers: Any) -> Vec:
    return Vec(jnp.asarray(np.real(numbers)), jnp.asarray(np.imag(numbers)))


def number(value: Vec) -> Complex:
    return np.asarray(value.x) + 1j * np.asarray(value.y)


def draw(count: int, seed: int) -> tuple[Complex, ...]:
    generator = np.random.default_rng(seed)
    return tuple(generator.normal(0, 100, count) + 1j * generator.normal(0, 100, count) for _ in range(2))


@jax.jit
def _calculate(a: Vec, b: Vec, factor: jax.Array) -> dict[str, Any]:
    return {
        "sum": a + b,
        "difference": a - b,
        "negative": -a,
        "multiple": a * factor,
        "perp": vector.perp(a),
        "part": a[7:9],
        "where": vector.where(factor > 0, a, b),
        "dot": vector.dot(a, b),
        "cross": vector.cross(a, b),
        "rotate": vector.rotate(a, b),
        "length": vector.length(a),
        "normalized": vector.normalized(a),
    }


def test_arithmetic_is_that_of_complex_numbers() -> None:
    one, two = draw(50, 0)
    factor = np.linspace(-2, 2, 50)
    ours = _calculate(vec(one), vec(two), jnp.asarray(factor))
    exact = {
        "sum": one + two,
        "difference": one - two,
        "negative": -one,
        "multiple": one * factor,
        "perp": 1j * one,
        "part": one[7:9],
        "where": np.where(factor > 0, one, two),
    }
    for name, value in exact.items():
        np.testing.assert_array_equal(number(ours[name]), value, name)
    close: Any = {"rtol": 1e-14, "atol": 1e-10}
    np.testing.assert_allclose(ours["dot"], (one.conj() * two).real, **close)
    np.testing.assert_allclose(ours["cross"], (one.conj() * two).imag, **close)
    np.testing.assert_allclose(number(ours["rotate"]), one * two, **close)
    np.testing.assert_allclose(ours["length"], abs(one), rtol=1e-15)
    np.testing.assert_allclose(number(ours["normalized"]), one / abs(one), rtol=1e-15)


def test_products_are_rounded_before_they_are_added() -> None:
    """Compiled, where a processor could multiply and add in one go, and bit for bit NumPy's, which does not."""
    one, two = draw(1000, 1)
    a, b = vec(one), vec(two)
    (ax, ay), (bx, by) = (one.real, one.imag), (two.real, two.imag)
    np.testing.assert_array_equal(jax.jit(vector.dot)(a, b), ax * bx + ay * by)
    np.testing.assert_array_equal(jax.jit(vector.cross)(a, b), ax * by - ay * bx)
    np.testing.assert_array_equal(jax.jit(vector.length)(a), np.sqrt(ax * ax + ay * ay))
    turned = jax.jit(vector.rotate)(a, b)
    np.testing.assert_array_equal(turned.x, ax * bx - ay * by)
    np.testing.assert_array_equal(turned.y, ax * by + ay * bx)
    moved = jax.jit(lambda a, b, t: a + b * t)(a, b, jnp.float64(1 / 60))
    np.testing.assert_array_equal(moved.x, ax + bx * (1 / 60))


def test_lerp_meets_both_ends_and_rounds_in_its_form() -> None:
    one, two = draw(200, 2)
    share = np.random.default_rng(3).random(200)
    lerp = jax.jit(vector.lerp)
    between = lerp(vec(one), vec(two), jnp.asarray(share))
    np.testing.assert_array_equal(between.x, one.real * (1 - share) + two.real * share)
    np.testing.assert_array_equal(between.y, one.imag * (1 - share) + two.imag * share)
    np.testing.assert_array_equal(number(lerp(vec(one), vec(two), np.zeros(200))), one)
    np.testing.assert_array_equal(number(lerp(vec(one), vec(two), np.ones(200))), two)


def test_special_values() -> None:
    odd = np.array([np.nan, np.inf, -np.inf, 0.0, 5e-324, 1e308])
    zero, single = vec(np.zeros(1)), jnp.zeros(1, jnp.float32)
    functions = jax.jit(lambda a, b, t: (vector.rounded(a), vector.normalized(b), vector.clamp01(t)))
    whole, direction, share = functions(odd, zero, np.array([-1, 0, 0.25, 1, 7]))
    np.testing.assert_array_equal(whole, odd)
    assert number(direction) == 0  # not NaN
    np.testing.assert_array_equal(share, [0, 0, 0.25, 1, 1])
    assert vector.rounds_as_reference(zero)
    assert not vector.rounds_as_reference(Vec(single, single))
    assert vector.rounded(single) is single  # float32 is left to the compiler

"""The search for the nearest side of two bars' difference set against brute force over random and degenerate pairs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import pytest

from iphyre_jax.physics.collision import gjk
from tests.physics.geometry import (
    Bars,
    Complex,
    corners,
    crossing,
    dot,
    nearest_on,
    number,
    random_bars,
    segment,
    shortest,
    vec,
    way_out,
)

COUNT = 400

Found = tuple[Complex, npt.NDArray[np.float64], npt.NDArray[np.int64]]  # normal, distance, side


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


_separation = jax.jit(gjk.separation)
_nearest = jax.jit(gjk.nearest)


def separation(one: Any, two: Any, start: Any = gjk.NO_SIDE) -> Found:
    bars = [segment((np.resize(a, COUNT), np.resize(b, COUNT))) for a, b in (one, two)]
    normal, distance, side = _separation(*bars, jnp.asarray(np.resize(start, COUNT), jnp.int32))
    return number(normal), np.asarray(distance), np.asarray(side)


def side_ends(one: Bars, two: Bars, side: npt.NDArray[np.int64]) -> Bars:
    every, pair = corners(one, two), np.arange(len(side))
    return every[side >> 2, pair], every[side & 3, pair]


def test_nearest_point_of_a_side_to_the_origin() -> None:
    (a, b), _ = random_bars(COUNT, 0, 300)
    point, inner, edge = _nearest(vec(a), vec(b))
    np.testing.assert_array_equal(number(edge), b - a)
    np.testing.assert_allclose(number(point), nearest_on((a, b), np.zeros(COUNT)), atol=1e-11)
    np.testing.assert_array_equal(inner, (dot(b - a, a) < 0) & (dot(b - a, b) > 0))
    assert 0.1 < np.mean(inner) < 0.9


def test_bars_apart_are_as_far_as_their_nearest_points() -> None:
    one, two = random_bars(COUNT, 1, 150)
    normal, distance, side = separation(one, two)
    apart, way = ~crossing(one, two), shortest(one, two)
    assert 100 < apart.sum() < COUNT
    np.testing.assert_allclose(distance[apart], abs(way)[apart], atol=1e-10)
    np.testing.assert_allclose(normal[apart], (way / abs(way))[apart], atol=1e-9)
    point = nearest_on(side_ends(one, two, side), np.zeros(COUNT))
    np.testing.assert_allclose(point[apart], way[apart], atol=1e-10)  # it lies on the side found


def test_crossing_bars_are_freed_by_the_shortest_shift() -> None:
    one, two = random_bars(COUNT, 2, 30)
    normal, distance, side = separation(one, two)
    cross = crossing(one, two)
    assert cross.sum() > 100
    np.testing.assert_array_equal(distance < 0, cross)
    np.testing.assert_allclose(-distance[cross], way_out(one, two)[cross], atol=1e-10)
    np.testing.assert_allclose(abs(normal), 1, atol=1e-12)
    shift = -distance * normal
    assert not crossing(one, (two[0] + 1.000001 * shift, two[1] + 1.000001 * shift))[cross].any()
    assert crossing(one, (two[0] + 0.999 * shift, two[1] + 0.999 * shift))[cross].all()
    a, b = side_ends(one, two, side)
    np.testing.assert_allclose(dot(normal, b - a)[cross], 0, atol=1e-10)


def test_the_normal_is_the_gradient_of_the_distance() -> None:
    one, two = random_bars(COUNT, 3, 100)
    normal, distance, _ = separation(one, two)
    step, slope = 1e-5, []
    for axis in (1, 1j):
        ahead, behind = (separation(one, (two[0] + s * axis, two[1] + s * axis))[1] for s in (step, -step))
        slope.append((ahead - behind) / (2 * step))
    smooth = abs(distance) > 0.1  # it has a kink where the cores begin to cross
    away = np.abs(slope[0] + 1j * slope[1] - normal)[smooth]
    assert np.quantile(away, 0.99) < 1e-5  # nor where two sides are equally near inside


def test_the_start_does_not_change_the_answer() -> None:
    one, two = random_bars(COUNT, 4, 80)
    normal, distance, found = separation(one, two)
    starts = [4 * v + w for v in range(4) for w in range(4) if v != w]
    for start in [*starts, found]:
        other_normal, other_distance, _ = separation(one, two, start)
        np.testing.assert_allclose(other_distance, distance, atol=1e-10)
        np.testing.assert_allclose(other_normal, normal, atol=1e-8)


def test_exchanged_bars_have_the_opposite_normal_bit_for_bit() -> None:
    one, two = random_bars(COUNT, 5, 80)
    normal, distance, side = separation(one, two)
    other_normal, other_distance, other_side = separation(two, one)
    np.testing.assert_array_equal(other_normal, -normal)
    np.testing.assert_array_equal(other_distance, distance)
    swapped = [2 * (code % 2) + code // 2 for code in range(4)]
    np.testing.assert_array_equal(np.take(swapped, other_side >> 2), side >> 2)
    np.testing.assert_array_equal(np.take(swapped, other_side & 3), side & 3)


def test_parallel_collinear_crossing_and_touching_bars() -> None:
    """Against a flat bar from 100 to 200. Bars on one line have no normal, as in the reference: they cannot push."""
    low = [130 + 15j, 150 - 30j, 200 + 20j, 260 + 20j, 220, 150 - 8j, 150, 150 - 3j]
    high = [260 + 15j, 90 - 30j, 300 + 20j, 300 + 20j, 300, 150 + 90j, 150 + 40j, 260 + 97j]
    normal, distance, _ = separation((100, 200), (low, high))
    gap = abs(60 + 20j)
    np.testing.assert_allclose(distance[:8], [15, 30, 20, gap, 0, -8, 0, -3], atol=1e-12)
    np.testing.assert_array_equal(normal[:2], [1j, -1j])
    np.testing.assert_allclose(normal[2:6], [1j, (60 + 20j) / gap, 0, 1j], atol=1e-12)

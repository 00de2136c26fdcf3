"""Contact points against geometry by hand, against brute force over random pairs, and pair by pair against pymunk."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pymunk
import pytest
from pymunk._chipmunk_cffi import lib

from iphyre_jax.physics.collision import gjk, narrow_phase
from iphyre_jax.physics.collision.narrow_phase import ManifoldPoint
from tests.physics.geometry import crossing, dot, nearest_on, number, random_bars, segment, shortest, vec, way_out
from tests.physics.worlds import DTYPES

both = pytest.mark.parametrize("dtype", DTYPES)

COUNT = 400
NEAR = {"float64": 1e-9, "float32": 1e-3}


_circles, _circle_bar = jax.jit(narrow_phase.circle_circle), jax.jit(narrow_phase.circle_segment)


@partial(jax.jit, static_argnums=3)
def _bars(one: Any, two: Any, first_is_a: jax.Array, searched: bool) -> Any:
    start = jnp.full(first_is_a.shape, gjk.NO_SIDE, jnp.int32) if searched else None
    return narrow_phase.segment_segment(one, two, first_is_a, start)[0]


def bars(one: Any, two: Any, dtype: str, first_is_a: bool = True) -> tuple[ManifoldPoint, ManifoldPoint]:
    with jax.enable_x64(dtype == "float64"):
        sides = (segment((np.resize(a, COUNT), np.resize(b, COUNT)), dtype) for a, b in (one, two))
        return jax.tree.map(np.asarray, _bars(*sides, np.full(COUNT, first_is_a), dtype == "float64"))


def circles(p: Any, r: Any, q: Any, s: Any, dtype: str, first_is_a: Any = True) -> ManifoldPoint:
    with jax.enable_x64(dtype == "float64"):
        p, q, r, s, first_is_a = (np.resize(given, COUNT) for given in (p, q, r, s, first_is_a))
        radii = jnp.asarray(r, dtype), jnp.asarray(s, dtype)
        touch = _circles(vec(p, dtype), radii[0], vec(q, dtype), radii[1], first_is_a)
        return jax.tree.map(np.asarray, touch)


def circle_bar(p: Any, r: Any, a: Any, b: Any, dtype: str) -> ManifoldPoint:
    with jax.enable_x64(dtype == "float64"):
        p, r, a, b = (np.resize(given, COUNT) for given in (p, r, a, b))
        return jax.tree.map(np.asarray, _circle_bar(vec(p, dtype), jnp.asarray(r, dtype), segment((a, b), dtype)))


@both
def test_two_balls_by_hand(dtype: str) -> None:
    """Overlapping along 3-4-5, exactly touching (which is apart), and with one centre, in both roles."""
    touch = circles([1 + 2j, 0, 7j, 7j], 30, [31 + 42j, 50, 7j, 7j], [25, 20, 25, 25], dtype, [True, True, True, False])
    assert touch.touching[:4].tolist() == [True, False, True, True]
    near: Any = {"rtol": 1e-6, "atol": 1e-5}
    np.testing.assert_allclose(number(touch.normal)[:4], [0.6 + 0.8j, 1, 1, -1], **near)
    np.testing.assert_allclose(number(touch.on_first)[:4], [19 + 26j, 30, 30 + 7j, -30 + 7j], **near)
    np.testing.assert_allclose(number(touch.on_second)[:4], [16 + 22j, 30, -25 + 7j, 25 + 7j], **near)


@both
def test_a_ball_and_a_bar_by_hand(dtype: str) -> None:
    """Over the side, exactly over the end, beyond the end, just touching (which is apart), and on the core line."""
    touch = circle_bar([150 - 25j, 200 - 25j, 203 + 4j, 150 + 30j, 150], 20, 100, 200, dtype)
    assert touch.touching[:5].tolist() == [True, True, True, False, True]
    near: Any = {"rtol": 1e-6, "atol": 1e-5}
    on_first = [150 - 5j, 200 - 5j, 191 - 12j, 150 + 10j, 150 - 20j]
    on_second = [150 - 10j, 200 - 10j, 206 + 8j, 150 + 10j, 150 + 10j]
    np.testing.assert_allclose(number(touch.normal)[:5], [1j, 1j, -0.6 - 0.8j, -1j, -1j], **near)
    np.testing.assert_allclose(number(touch.on_first)[:5], on_first, **near)
    np.testing.assert_allclose(number(touch.on_second)[:5], on_second, **near)


@both
def test_two_bars_by_hand(dtype: str) -> None:
    """One on the other, end on side, end to end, exactly 20 apart (which touches), too far, and on one line."""
    low = [130 + 15j, 150 - 12j, 209 + 12j, 100 + 20j, 100 + 21j, 210]
    high = [260 + 15j, 170 - 90j, 260 + 24j, 200 + 20j, 200 + 21j, 300]
    first, second = bars((100, 200), (low, high), dtype)
    assert (first.touching | second.touching)[:5].tolist() == [True, True, True, True, False]
    np.testing.assert_allclose(number(first.normal)[:5], [1j, -1j, 0.6 + 0.8j, 1j, 1j], atol=1e-6)
    assert not first.touching[5] or number(first.normal)[5] == 0  # on one line the reference cannot push
    for k, points in enumerate(
        (
            [(130 + 10j, 130 + 5j), (200 + 10j, 200 + 5j)],
            [(150 - 10j, 150 - 2j)],
            [(206 + 8j, 203 + 4j)],
            [(100 + 10j, 100 + 10j), (200 + 10j, 200 + 10j)],
        )
    ):
        here = [touch for touch in (first, second) if touch.touching[k]]
        found = np.array([[number(touch.on_first)[k], number(touch.on_second)[k]] for touch in here])
        away = abs(found[:, None] - np.array(points)).max(-1)  # two points may be one
        assert away.min(0).max() < 1e-4
        assert away.min(1).max() < 1e-4


@both
def test_random_balls_touch_where_they_are_nearest(dtype: str) -> None:
    generator = np.random.default_rng(0)
    p, q = generator.uniform(-60, 60, (2, COUNT)) + 1j * generator.uniform(-60, 60, (2, COUNT))
    r, s = generator.uniform(5, 60, (2, COUNT))
    bar, _ = random_bars(COUNT, 1, 60)
    for touch, target, other in (
        (circles(p, r, q, s, dtype), q, s),
        (circle_bar(p, r, *bar, dtype), nearest_on(bar, p), 10),
    ):
        way = target - p
        normal = way / abs(way)
        np.testing.assert_array_equal(touch.touching, abs(way) < r + other)
        assert 0.1 < np.mean(touch.touching) < 0.9
        np.testing.assert_allclose(number(touch.normal), normal, atol=NEAR[dtype])
        np.testing.assert_allclose(number(touch.on_first), p + r * normal, atol=NEAR[dtype])
        np.testing.assert_allclose(number(touch.on_second), target - other * normal, atol=NEAR[dtype])


@both
def test_random_bars_touch_where_they_are_nearest(dtype: str) -> None:
    """The deepest point is as deep as the cores are near; both points lie on the surfaces, one against the other."""
    one, two = random_bars(COUNT, 2, 100)
    first, second = bars(one, two, dtype)
    cross = crossing(one, two)
    apart, way, normal = ~cross, shortest(one, two), number(first.normal)
    distance = np.where(apart, abs(way), -way_out(one, two))
    near = distance <= 20
    np.testing.assert_array_equal(first.touching | second.touching, near)
    assert min(np.sum(apart & near), np.sum(cross), np.sum(apart & ~near)) > 50
    shift = -1.001 * distance * normal
    assert not crossing(one, (two[0] + shift, two[1] + shift))[cross].any()
    np.testing.assert_allclose(normal[apart], (way / abs(way))[apart], atol=10 * NEAR[dtype])
    deepest = np.full(COUNT, np.inf)
    for touch in (first, second):
        on_first, on_second = number(touch.on_first), number(touch.on_second)
        depth = dot(normal, on_second - on_first)
        assert (depth[touch.touching] <= 0).all()
        deepest = np.where(touch.touching, np.minimum(deepest, depth), deepest)
        core_one, core_two = on_first - 10 * normal, on_second + 10 * normal
        np.testing.assert_allclose(nearest_on(one, core_one), core_one, atol=NEAR[dtype])
        np.testing.assert_allclose(nearest_on(two, core_two), core_two, atol=NEAR[dtype])
    np.testing.assert_allclose(deepest[near], distance[near] - 20, atol=NEAR[dtype])


def test_exchanged_bars_have_the_same_points_exchanged() -> None:
    one, two = random_bars(COUNT, 3, 40)
    for touch, other in zip(
        bars(one, two, "float64"), reversed(bars(two, one, "float64", first_is_a=False)), strict=True
    ):
        here = np.asarray(touch.touching)
        np.testing.assert_array_equal(touch.touching, other.touching)
        np.testing.assert_array_equal(number(touch.normal), -number(other.normal))
        np.testing.assert_array_equal(number(touch.on_first)[here], number(other.on_second)[here])
        np.testing.assert_array_equal(number(touch.on_second)[here], number(other.on_first)[here])
        np.testing.assert_array_equal(touch.id, 2 * (other.id % 2) + other.id // 2)


def reference(one: pymunk.Shape, two: pymunk.Shape) -> list[float]:
    """Return normal and points of a pair as pymunk finds them, none if they do not touch."""
    for shape in (one, two):
        shape.cache_bb()
    found = lib.cpShapesCollide(one._shape, two._shape)
    points = [found.points[k] for k in range(found.count)]
    pairs = [end for point in points for end in (point.pointA, point.pointB)]
    return [coordinate for at in (found.normal, *pairs) for coordinate in (at.x, at.y)] if points else []


def ours(touches: tuple[ManifoldPoint, ...], k: int) -> list[float]:
    here = [touch for touch in touches if touch.touching[k]]
    pairs = [end for touch in here for end in (touch.on_first, touch.on_second)]
    return [float(part[k]) for at in (here[0].normal, *pairs) for part in (at.x, at.y)] if here else []


def test_every_kind_of_pair_is_pymunks_to_the_last_bit() -> None:
    """A tenth of the bars lie flat at whole numbers, where equally near sides are usual."""
    flat = np.arange(COUNT) % 10 == 0
    one, two = ([np.where(flat, end.real.round(-1), end) for end in bar] for bar in random_bars(COUNT, 4, 60))
    two = [np.where(flat, end + 20j, end) for end in two]
    p, q = one[0], two[1]
    r, s = np.random.default_rng(5).uniform(5, 60, (2, COUNT))
    found = (circles(p, r, q, s, "float64"),), (circle_bar(p, r, *two, "float64"),), bars(one, two, "float64")
    touching = [0, 0, 0]
    body = pymunk.Body(body_type=pymunk.Body.STATIC)
    for k in range(COUNT):
        balls = [pymunk.Circle(body, radius, (at.real, at.imag)) for at, radius in ((p[k], r[k]), (q[k], s[k]))]
        ends = [[(end[k].real, end[k].imag) for end in bar] for bar in (one, two)]
        lines = [pymunk.Segment(body, a, b, 10) for a, b in ends]
        for kind, pair in enumerate((balls, (balls[0], lines[1]), lines)):
            expected = reference(*pair)
            touching[kind] += bool(expected)
            assert ours(found[kind], k) == expected, (kind, k)
    assert min(touching) > 100
    assert max(touching) < COUNT

"""Shapes in the world against rotations in NumPy: ends, normals, boxes, rows and their order."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import physics
from iphyre_jax.physics.collision import shapes
from iphyre_jax.physics.types import Box
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.compile import compile_scene
from tests.physics.worlds import DTYPES, make_scene

both = pytest.mark.parametrize("dtype", DTYPES)

STATIC = [(100.0, 300.0, 200.0, 340.0), (250.0, 260.0, 250.0, 200.0)]
MOVING = [(50.0, 80.0, 130.0, 20.0), (420.0, 100.0, 400.0, 180.0)]
BALLS = [(300.0, 60.0, 20.0), (500.0, 420.0, 31.5)]
CENTRES = np.array([100 + 40j, 333 + 222j, 10 - 5j, 480.25 + 77j])  # of the moving bars, then the balls
ANGLES = np.array([0.7, -2.5, 1.0, 40.0])
LOCAL = np.array([[complex(x1 - x2, y1 - y2) / 2, complex(x2 - x1, y2 - y1) / 2] for x1, y1, x2, y2 in MOVING])
PLACES = 10  # for static bars


def number(value: Vec) -> Any:
    return np.asarray(value.x, np.float64) + 1j * np.asarray(value.y, np.float64)


def vec(numbers: Any, dtype: str) -> Vec:
    return Vec(jnp.asarray(numbers.real, dtype), jnp.asarray(numbers.imag, dtype))


@cache
def placed(dtype: str) -> tuple[Any, Any, shapes.Shapes, Box]:
    """Return the shapes with the moving bodies at CENTRES, turned by ANGLES, the second static bar gone."""
    topology, world = compile_scene(make_scene(BALLS, STATIC, MOVING), dtype=dtype)

    @jax.jit
    def place() -> tuple[shapes.Shapes, Box]:
        state = physics.initial_state(topology, world)
        state = replace(
            state,
            position=vec(CENTRES, dtype),
            angle=jnp.asarray(ANGLES, dtype),
            position_compensation=vec(CENTRES[: len(state.position_compensation.x)] / 2**30, dtype),
            alive=state.alive.at[1].set(False),
        )
        shape = shapes.world_shapes(topology, world, state)
        return shape, shapes.moving_boxes(topology, shape)

    with jax.enable_x64(dtype == "float64"):
        return topology, world, *jax.tree.map(np.asarray, place())


@both
def test_bars_are_turned_about_their_centres(dtype: str) -> None:
    close: Any = {"rtol": 0, "atol": 1e-12 if dtype == "float64" else 2e-5}
    _, world, shape, _ = placed(dtype)
    bars = [shapes.bar(row) for row in shape.bars]
    balls = [shapes.ball(row) for row in shape.balls]
    relative = dtype == "float32"  # there ends are counted from the centre
    for k, turn in enumerate(np.exp(1j * ANGLES[:2])):
        ends = LOCAL[k] * turn + (0 if relative else CENTRES[k])
        along = (LOCAL[k][1] - LOCAL[k][0]) * turn
        np.testing.assert_allclose([number(bars[k].segment.a), number(bars[k].segment.b)], ends, **close)
        np.testing.assert_allclose(number(bars[k].segment.normal), -1j * along / abs(along), **close)
        np.testing.assert_allclose(number(bars[k].centre), CENTRES[k], **close)
    for static, k in ((number(world.static_a)[0], 2), (number(world.static_a)[1], 3)):
        start = static - (number(world.static_centre)[k - 2] if relative else 0)
        np.testing.assert_allclose(number(bars[k].segment.a), start, **close)
        np.testing.assert_array_equal(number(bars[k].segment.normal), number(world.static_normal)[k - 2])
        np.testing.assert_array_equal(number(bars[k].centre), number(world.static_centre)[k - 2])
    np.testing.assert_allclose([number(ball.centre) for ball in balls], CENTRES[2:], **close)
    assert [float(ball.radius) for ball in balls] == [20, 31.5]
    if relative:
        compensations = [number(row.compensation) for row in (*bars[:3], *balls)]
        np.testing.assert_allclose(compensations, [*CENTRES[:2] / 2**30, 0, *CENTRES[2:] / 2**30], rtol=1e-6)
    else:
        assert bars[0].compensation is None
        assert balls[0].compensation is None


@both
def test_boxes_hold_the_shapes_and_not_more(dtype: str) -> None:
    close: Any = {"rtol": 0, "atol": 1e-12 if dtype == "float64" else 1e-4}
    _, world, shape, moving = placed(dtype)
    ends = [LOCAL[k] * np.exp(1j * ANGLES[k]) + CENTRES[k] for k in range(2)]
    ends += [np.array([number(world.static_a)[k], number(world.static_b)[k]]) for k in range(2)]
    sides = [shape.bar_box.left, shape.bar_box.top, shape.bar_box.right, shape.bar_box.bottom]
    for k, pair in enumerate(ends):
        box = pair.real.min() - 10, pair.imag.min() - 10, pair.real.max() + 10, pair.imag.max() + 10
        np.testing.assert_allclose([side[k] for side in sides], box, **close)
    centre, radius = CENTRES[2:], np.array([20, 31.5])
    balls = centre.real - radius, centre.imag - radius, centre.real + radius, centre.imag + radius
    for side, bars, ball in zip((moving.left, moving.top, moving.right, moving.bottom), sides, balls, strict=True):
        np.testing.assert_array_equal(side[:2], bars[:2])
        np.testing.assert_allclose(side[2:], ball, **close)
    assert shape.alive.tolist() == [True, True, True, False] + [False] * (PLACES - 2)

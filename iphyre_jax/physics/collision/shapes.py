"""All shapes of a world where they are now, as rows that the collision loops read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes, tables
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.physics.types import Box, Segment, State, Topology, World
from iphyre_jax.physics.vector import Vec, is_exact, product

Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Shapes:
    """m moving bars, then S static ones; balls.

    The reference computes contacts in the world frame, and so does float64. In float32, coordinates of hundreds of px
    cost three digits. So float32 uses relative ones: bars to their centres here, pairs to the first body in `contacts`.
    """

    bars: jax.Array  # (m + S, columns), see `tables.BAR_A`; in float32 the ends are relative to the centre
    balls: jax.Array  # (balls, columns), see `tables.BALL_CENTRE`
    bar_box: Box  # (m + S,)
    ball_box: Box  # (balls,)
    alive: jax.Array  # (m + S,) bool


@dataclass(frozen=True)
class Bar:
    """One bar, from a row of `Shapes.bars`."""

    segment: Segment
    centre: Vec  # px
    compensation: Vec | None  # px, belongs to the centre; None in float64


@dataclass(frozen=True)
class Ball:
    """One ball, from a row of `Shapes.balls`."""

    centre: Vec  # px
    radius: jax.Array  # px
    compensation: Vec | None


def world_shapes(topology: Topology, world: World, state: State) -> Shapes:
    """Return all shapes where they are now."""
    m = topology.bars
    angle, centre = state.angle[:m], state.position[:m]
    turn = Vec(jnp.cos(angle), jnp.sin(angle))

    def turned(local: Vec) -> Vec:  # row by row of the reference's matrix: (cos x + -sin y) + t
        x = product(turn.x, local.x) + product(-turn.y, local.y)
        y = product(turn.y, local.x) + product(turn.x, local.y)
        return Vec(x, y)

    moving = Segment(turned(world.bar_a), turned(world.bar_b), turned(world.bar_normal))
    static = Segment(world.static_a, world.static_b, world.static_normal)
    in_world = _join(shifted(moving, centre), static)
    bar_centre = _join(centre, world.static_centre)
    balls = state.position[m:]
    bars = in_world
    of_bars: tuple[jax.Array, ...] = ()
    of_balls: tuple[jax.Array, ...] = ()
    if not world.exact:
        bars = _join(moving, shifted(static, -world.static_centre))
        still = jax.tree.map(jnp.zeros_like, world.static_centre)
        of_bars, of_balls = _xy(_join(state.position_compensation[:m], still)), _xy(state.position_compensation[m:])
    return Shapes(
        bars=lanes.stack([*_xy(bars.a), *_xy(bars.b), *_xy(bars.normal), *_xy(bar_centre), *of_bars], axis=1),
        balls=lanes.stack([*_xy(balls), world.radius, *of_balls], axis=1),
        bar_box=_bar_box(in_world),
        ball_box=Box(balls.x - world.radius, balls.y - world.radius, balls.x + world.radius, balls.y + world.radius),
        alive=jnp.concatenate([jnp.ones_like(angle, bool), state.alive]),
    )


def bar(row: jax.Array) -> Bar:
    """Return the bar of one row, (columns,)."""
    segment = Segment(*(tables.vec(row, column) for column in (tables.BAR_A, tables.BAR_B, tables.BAR_NORMAL)))
    centre = tables.vec(row, tables.BAR_CENTRE)
    return Bar(segment, centre, None if is_exact(row) else tables.vec(row, tables.BAR_COMPENSATION))


def ball(row: jax.Array) -> Ball:
    """Return the ball of one row, (columns,)."""
    centre, radius = tables.vec(row, tables.BALL_CENTRE), row[tables.BALL_RADIUS]
    return Ball(centre, radius, None if is_exact(row) else tables.vec(row, tables.BALL_COMPENSATION))


def shifted(segment: Segment, by: Vec) -> Segment:
    """Return a segment moved by a vector."""
    return Segment(segment.a + by, segment.b + by, segment.normal)


def _xy(vec: Vec) -> tuple[jax.Array, jax.Array]:
    return vec.x, vec.y


def _join(first: Tree, second: Tree) -> Tree:
    """Concatenate the rows of two trees."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, second)


def _bar_box(segment: Segment) -> Box:
    r = BAR_RADIUS
    low_x, high_x = jnp.minimum(segment.a.x, segment.b.x), jnp.maximum(segment.a.x, segment.b.x)
    low_y, high_y = jnp.minimum(segment.a.y, segment.b.y), jnp.maximum(segment.a.y, segment.b.y)
    return Box(low_x - r, low_y - r, high_x + r, high_y + r)


def moving_boxes(topology: Topology, shapes: Shapes) -> Box:
    """Return the exact boxes of the moving bodies, bars first."""
    return _join(jax.tree.map(lambda edge: edge[: topology.bars], shapes.bar_box), shapes.ball_box)

"""Collision: from shapes to the ordered slots that the solver works through.

Candidate pairs are those whose exact boxes overlap in at least one lane; the loops below visit only these, so a world
pays for what it and its neighbours touch. A candidate's points become rows; a row's order key (see `broadphase`) gives
its position among the touching points of its lane; the rows are packed into K slots by position.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.physics import broadphase, lanes
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.physics.narrowphase import Segment, Touch, circle_circle, circle_segment, segment_segment
from iphyre_jax.physics.types import STATIC, Box, BroadPhase, State, Topology, World
from iphyre_jax.physics.vector import Vec, dot, product, rounds_as_reference

Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Shapes:
    """All shapes. m moving bars, then S static ones; balls.

    The reference computes contacts in the world frame, and so does float64. In float32 coordinates of hundreds of px
    cost three digits, so there all is relative: bars to their centres here, pairs to the first body in `_visit`.
    """

    bars: Segment  # (m + S,) in the world frame; in float32 relative to the bar's centre
    bar_centre: Vec  # (m + S,) px
    bar_residue: Vec  # (m + S,) px, belongs to the centre; no rows in float64
    bar_box: Box  # (m + S,)
    ball_box: Box  # (balls,)
    ball_centre: Vec  # (balls,) px
    alive: jax.Array  # (m + S,) bool


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Points:
    """Contact points as rows: of candidates (any order) or in slots (solve order)."""

    key: jax.Array  # int32, order key; KEY_NONE: no contact
    id: jax.Array  # int32, identity of the point for the contact cache; -1: none
    first: jax.Array  # int32, moving body of role first
    second: jax.Array  # int32, the other body, STATIC if it does not move
    normal: Vec  # unit, from first to second
    arm_first: Vec  # px, from the body's centre to its contact point
    arm_second: Vec
    distance: jax.Array  # px along the normal, negative when overlapping


def world_shapes(topology: Topology, world: World, state: State) -> Shapes:
    """Return all shapes where they are now."""
    m = topology.bars
    angle, centre = state.angle[:m], state.position[:m]
    turn = Vec(jnp.cos(angle), jnp.sin(angle))

    def place(local: Vec) -> Vec:  # row by row of the reference's matrix: (cos x + -sin y) + t
        x = product(turn.x, local.x) + product(-turn.y, local.y)
        y = product(turn.y, local.x) + product(turn.x, local.y)
        return Vec(x, y)

    moving = Segment(place(world.bar_a), place(world.bar_b), place(world.bar_normal))
    static = Segment(world.static_a, world.static_b, world.static_normal)
    residue = state.residue[:0]
    if rounds_as_reference(centre):
        bars = _join(_shifted(moving, centre), static)
        in_world = bars
    else:
        bars = _join(moving, _shifted(static, -world.static_centre))
        in_world = _join(_shifted(moving, centre), static)
        residue = _join(state.residue[:m], jax.tree.map(jnp.zeros_like, world.static_centre))
    bar_centre = _join(centre, world.static_centre)
    alive = jnp.concatenate([jnp.ones_like(state.alive[:1]).repeat(m, 0), state.alive]) if m else state.alive
    balls, r = state.position[m:], world.radius
    ball_box = Box(balls.x - r, balls.y - r, balls.x + r, balls.y + r)
    return Shapes(bars, bar_centre, residue, _bar_box(in_world), ball_box, balls, alive)


def _join(first: Tree, second: Tree) -> Tree:
    """Concatenate the rows of two trees."""
    return jax.tree.map(lambda a, b: jnp.concatenate([a, b]), first, second)


def _shifted(bars: Segment, by: Vec) -> Segment:
    return Segment(bars.a + by, bars.b + by, bars.normal)


def _bar_box(bar: Segment) -> Box:
    r = BAR_RADIUS
    low_x, high_x = jnp.minimum(bar.a.x, bar.b.x), jnp.maximum(bar.a.x, bar.b.x)
    low_y, high_y = jnp.minimum(bar.a.y, bar.b.y), jnp.maximum(bar.a.y, bar.b.y)
    return Box(low_x - r, low_y - r, high_x + r, high_y + r)


def moving_boxes(topology: Topology, shapes: Shapes) -> Box:
    """Return the exact boxes of the moving bodies, bars first."""
    return _join(jax.tree.map(lambda bars: bars[: topology.bars], shapes.bar_box), shapes.ball_box)


@dataclass(frozen=True)
class Pair:
    """Where the bodies of a pair are in the frame in which their contact is computed."""

    apart: Vec  # px, from the first body's centre to the second's
    first: Vec  # px, centre of the first body
    second: Vec
    shift: Vec | None  # px, takes the second body's bar into the frame; None: it is there


def _pair(first: Vec, second: Vec, residue: Callable[[], tuple[Vec, Vec]]) -> Pair:
    """Return the world frame in float64; in float32 the first body's, with what rounding took from the positions."""
    apart = second - first
    if rounds_as_reference(apart):
        return Pair(apart, first, second, None)
    of_first, of_second = residue()
    apart = apart + (of_second - of_first)
    return Pair(apart, jax.tree.map(jnp.zeros_like, apart), apart, apart)


@dataclass(frozen=True)
class _Kind:
    """One kind of pair: its candidates, and how to find their contact points."""

    pairs: tuple[tuple[int, int], ...]
    overlap: jax.Array  # (pairs, *lanes) bool
    points: Callable[[jax.Array, jax.Array, Pair], tuple[Touch, ...]]
    bodies: Callable[[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]  # moving-body index or -(1 + static) each
    first_id: int


def collide(
    topology: Topology, world: World, shapes: Shapes, broad: BroadPhase, state: State
) -> tuple[Points, jax.Array]:
    """Return the touching points of every lane in solve order, (K,) rows, and how many there are (it may exceed K)."""
    rank = broadphase.ranks(broad.path) if topology.moving > 1 else jnp.zeros_like(broad.path)
    capacity = len(topology.ball_pairs) + len(topology.ball_bar_pairs) + 2 * len(topology.bar_pairs)
    like = state.position.x[0]
    rows, count = _empty(capacity, like), jnp.int32(0)
    for kind in _kinds(topology, world, shapes):
        if kind.pairs:
            rows, count = _visit(topology, world, broad, rank, state, shapes, kind, rows, count)
    return _pack(topology, rows, count, like)


def _kinds(topology: Topology, world: World, shapes: Shapes) -> list[_Kind]:
    m = topology.bars
    ball_bar, ball_ball, bar_bar = topology.ball_bar_pairs, topology.ball_pairs, topology.bar_pairs

    def body_of_bar(bar: jax.Array) -> jax.Array:
        return jnp.where(bar < m, bar, m - 1 - bar)

    def second_bar(bar: jax.Array, pair: Pair) -> Segment:
        segment = lanes.row(shapes.bars, bar)
        return segment if pair.shift is None else _shifted(segment, pair.shift)

    def ball_bar_points(ball: jax.Array, bar: jax.Array, pair: Pair) -> tuple[Touch, ...]:
        return (circle_segment(pair.first, lanes.row(world.radius, ball), second_bar(bar, pair)),)

    def ball_ball_points(i: jax.Array, j: jax.Array, pair: Pair) -> tuple[Touch, ...]:
        return (circle_circle(pair.first, lanes.row(world.radius, i), pair.second, lanes.row(world.radius, j)),)

    def bar_bar_points(i: jax.Array, j: jax.Array, pair: Pair) -> tuple[Touch, ...]:
        return segment_segment(lanes.row(shapes.bars, i), second_bar(j, pair))

    balls_overlap = [
        broadphase.overlap(*(jax.tree.map(lambda a, k=k: a[k : k + 1], shapes.ball_box) for k in pair))
        for pair in ball_ball
    ]
    ball_bar_overlap = [
        broadphase.overlap(jax.tree.map(lambda a, i=i: a[i : i + 1], shapes.ball_box), shapes.bar_box) & shapes.alive
        for i in range(topology.balls)
    ]
    bar_bar_overlap = [
        broadphase.overlap(
            jax.tree.map(lambda a, i=i: a[i : i + 1], shapes.bar_box),
            jax.tree.map(lambda a, i=i: a[i + 1 :], shapes.bar_box),
        )
        & shapes.alive[i + 1 :]
        for i in range(m)
    ]

    def stack(parts: list[jax.Array]) -> jax.Array:
        return jnp.concatenate(parts) if parts else shapes.alive[:0]

    return [
        _Kind(ball_bar, stack(ball_bar_overlap), ball_bar_points, lambda i, j: (m + i, body_of_bar(j)), 0),
        _Kind(ball_ball, stack(balls_overlap), ball_ball_points, lambda i, j: (m + i, m + j), len(ball_bar)),
        _Kind(
            bar_bar,
            stack(bar_bar_overlap),
            bar_bar_points,
            lambda i, j: (i, body_of_bar(j)),
            len(ball_bar) + len(ball_ball),
        ),
    ]


def _empty(capacity: int, like: jax.Array) -> Points:
    shape = (capacity, *like.shape)
    number = jnp.zeros(shape, like.dtype)
    whole = jnp.zeros(shape, jnp.int32)
    vec = Vec(number, number)
    return Points(whole, whole, whole, whole, vec, vec, vec, number)


def _visit(
    topology: Topology,
    world: World,
    broad: BroadPhase,
    rank: jax.Array,
    state: State,
    shapes: Shapes,
    kind: _Kind,
    rows: Points,
    count: jax.Array,
) -> tuple[Points, jax.Array]:
    """Append the points of the candidates of one kind to the rows."""
    table = np.array(kind.pairs, np.int32)
    table_first, table_second = jnp.asarray(table[:, 0]), jnp.asarray(table[:, 1])
    m = topology.bars

    def visit(carry: tuple[jax.Array, Points, jax.Array]) -> tuple[jax.Array, Points, jax.Array]:
        words, rows, count = carry
        pair, words = lanes.first_set(words)
        i, j = table_first[pair], table_second[pair]
        overlap = lanes.row(kind.overlap, pair)
        first, second = kind.bodies(i, j)
        is_static = second < 0
        key, first_is_a = _key(topology, world, broad, rank, first, second)

        def second_row(of_bars: Vec, of_bodies: Vec) -> Vec:
            return jax.lax.cond(
                is_static,
                lambda: lanes.row(of_bars, m - 1 - second),
                lambda: lanes.row(of_bodies, jnp.maximum(second, 0)),
            )

        pair_at = _pair(
            lanes.row(state.position, first),
            second_row(shapes.bar_centre, state.position),
            lambda: (lanes.row(state.residue, first), second_row(shapes.bar_residue, state.residue)),
        )
        touches = kind.points(i, j, pair_at)
        for place, touch in enumerate(touches):
            arm_first, arm_second = touch.on_first - pair_at.first, touch.on_second - pair_at.second
            touching = touch.touching & overlap
            order = key if len(touches) == 1 else key | jnp.where(first_is_a, place, 1 - place)
            point = Points(
                jnp.where(touching, order, broadphase.KEY_NONE),
                4 * (kind.first_id + pair) + _class(world, pair, touch.id, len(touches)),
                jnp.broadcast_to(first, order.shape),
                jnp.broadcast_to(jnp.where(is_static, STATIC, second), order.shape),
                touch.normal,
                arm_first,
                arm_second,
                dot((arm_second - arm_first) + pair_at.apart, touch.normal),
            )
            rows, count = lanes.set_row(rows, count, point), count + 1
        return words, rows, count

    start = lanes.any_lane(kind.overlap), rows, count
    _, rows, count = jax.lax.while_loop(lambda carry: jnp.any(carry[0] != 0), visit, start)
    return rows, count


def _key(
    topology: Topology, world: World, broad: BroadPhase, rank: jax.Array, first: jax.Array, second: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return a pair's order key and whether its first body has role a."""

    def static() -> tuple[jax.Array, jax.Array]:
        place = -1 - second
        counter = lanes.row(world.static_counter, first * topology.statics + place)
        return broadphase.static_key(topology, broad, rank, first, place, counter), lanes.row(broad.updated, first)

    def moving() -> tuple[jax.Array, jax.Array]:
        low, high = jnp.minimum(first, second), jnp.maximum(first, second)
        pair = low * (2 * topology.moving - low - 1) // 2 + high - low - 1
        key, low_is_a = broadphase.moving_key(topology, broad, rank, low, high, pair)
        return key, low_is_a == (low == first)

    return static() if topology.moving == 1 else jax.lax.cond(second < 0, static, moving)


def _class(world: World, pair: jax.Array, point_id: jax.Array, points: int) -> jax.Array:
    """Return the id of a point of two bars, or the lower one that the reference cannot tell from it."""
    if points == 1:
        return point_id
    classes = [lanes.row(world.point_class[k], pair) for k in range(4)]
    return jnp.select(
        [point_id == k for k in range(3)], [jnp.broadcast_to(k, point_id.shape) for k in classes[:3]], classes[3]
    )


def _pack(topology: Topology, rows: Points, count: jax.Array, like: jax.Array) -> tuple[Points, jax.Array]:
    """Pack the touching rows into slots by their order; a row beyond the last slot is left out (and counted)."""
    slot = lanes.iota(topology.slots, like)
    empty = _empty(topology.slots, like)
    empty = Points(
        empty.key,
        empty.id - 1,
        empty.first,
        empty.second + STATIC,
        *(empty.normal, empty.arm_first, empty.arm_second, empty.distance),
    )

    def place(q: jax.Array, carry: tuple[Points, jax.Array]) -> tuple[Points, jax.Array]:
        slots, total = carry
        point = lanes.row(rows, q)

        def before(r: jax.Array, position: jax.Array) -> jax.Array:
            return position + (lanes.row(rows.key, r) < point.key).astype(jnp.int32)

        position = jax.lax.fori_loop(0, count, before, jnp.zeros_like(point.key))
        touching = point.key != broadphase.KEY_NONE
        here = (slot == jnp.expand_dims(position, 0)) & jnp.expand_dims(touching, 0)
        slots = jax.tree.map(lambda old, new: jnp.where(here, jnp.expand_dims(new, 0), old), slots, point)
        return slots, total + touching.astype(jnp.int32)

    return jax.lax.fori_loop(0, count, place, (empty, jnp.zeros_like(empty.key[0])))

"""Collision: from shapes to the ordered slots that the solver works through.

Candidate pairs are those whose exact boxes overlap in at least one lane. The loops below visit only these, so a world
pays for what it and its neighbours touch. Touching points take the next free slot of their lane. At the end the slots
are put in order by their keys (see `broad_phase.order`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.physics import lanes
from iphyre_jax.physics.collision import broad_phase, gjk, shapes
from iphyre_jax.physics.collision.contact_table import (
    BODY_BITS,
    KEY_NONE,
    STATIC_BODY,
    ContactBuffer,
    ContactFrame,
    ContactTable,
    point_numbers,
)
from iphyre_jax.physics.collision.narrow_phase import ManifoldPoint, circle_circle, circle_segment, segment_segment
from iphyre_jax.physics.collision.shapes import Ball, Bar, Shapes
from iphyre_jax.physics.tables import PAIR_FIRST_IS_A, PAIR_KEY, PAIR_POINT_CLASS
from iphyre_jax.physics.types import Box, BroadPhase, Segment, Topology, World


class Manifold(NamedTuple):
    """The possible contact points of one pair."""

    frame: ContactFrame
    points: tuple[ManifoldPoint, ...]
    gjk_end: jax.Array | None = None  # int32, the side at which the search ended, if there was one


@dataclass(frozen=True)
class PairType:
    """Ball and bar, two balls, or two bars: the candidates, and how to find their contact points."""

    pairs: tuple[tuple[int, int], ...]  # rows of the two tables
    bodies: tuple[tuple[int, int], ...]  # moving body, or STATIC_BODY
    first_id: int
    info: jax.Array  # (pairs, columns) int32, see `tables.PAIR_KEY` and those after it
    tables: tuple[jax.Array, jax.Array]  # two arrays: two rows of one array would be read in one loop, of scalar code
    manifold: Callable[[jax.Array, jax.Array, jax.Array, jax.Array | None], Manifold]  # of rows: tables, info, start
    two_bars: bool = False  # two points, each with an id
    uses_gjk: bool = False


def collide(
    topology: Topology, world: World, shape: Shapes, broad: BroadPhase, gjk_start: jax.Array
) -> tuple[ContactTable, jax.Array, jax.Array]:
    """Find the touching points of every lane.

    Returns:
        The points in solve order, (K,) rows; how many there are, () int32, which may exceed K; the new `gjk_start`.
    """
    order = lanes.materialize(lambda: broad_phase.order(topology, world, broad))
    found, none = ContactBuffer.empty(topology.slots, shape.balls[0, 0]), gjk_start[:0]
    for pair_type in (_ball_bar(topology, shape, order), _ball_ball(topology, shape, order)):
        if pair_type is not None:
            found, _ = _visit(pair_type, found, none)
    bars = _bar_bar(topology, world, shape, broad, order)
    if bars is not None and not bars.uses_gjk:
        found, _ = _visit(bars, found, none)
    elif bars is not None:
        # A new pair has no side to start from. If its owner inserted it, the reference forgets this step's side, too.
        renewed = [broad.updated[i] | broad.updated[j] for i, j in topology.pairs]
        gjk_start = jnp.where(_of_bar_pairs(topology, renewed, broad.updated), gjk.NO_SIDE, gjk_start)
        found, gjk_start = _visit(bars, found, gjk_start)
        gjk_start = jnp.where(_of_bar_pairs(topology, order.by_owner, broad.updated), gjk.NO_SIDE, gjk_start)
    return found.in_order(), found.total, gjk_start


def _ball_bar(topology: Topology, shape: Shapes, order: broad_phase.OrderKeys) -> PairType:
    m, pairs = topology.bars, topology.ball_bar_pairs

    def manifold(ball_row: jax.Array, bar_row: jax.Array, *_: jax.Array | None) -> Manifold:
        ball, bar = shapes.ball(ball_row), shapes.bar(bar_row)
        frame = _frame(ball, bar)
        return Manifold(frame, (circle_segment(frame.first, ball.radius, _second_segment(bar, frame)),))

    def columns() -> list[jax.Array]:
        keys = []
        for ball in range(topology.balls):
            near = broad_phase.overlap(_slice(shape.ball_box, ball, ball + 1), shape.bar_box) & shape.alive
            keys.append(jnp.where(near, order.of(topology, m + ball, range(m)), KEY_NONE))
        return [jnp.concatenate(keys)]

    bodies = tuple((m + i, j if j < m else STATIC_BODY) for i, j in pairs)
    return PairType(pairs, bodies, 0, _info(columns), (shape.balls, shape.bars), manifold)


def _ball_ball(topology: Topology, shape: Shapes, order: broad_phase.OrderKeys) -> PairType | None:
    m, pairs = topology.bars, topology.ball_pairs
    if not pairs:
        return None

    def manifold(first_row: jax.Array, second_row: jax.Array, info: jax.Array, _: jax.Array | None) -> Manifold:
        first, second = shapes.ball(first_row), shapes.ball(second_row)
        frame, first_is_a = _frame(first, second), info[PAIR_FIRST_IS_A] != 0
        return Manifold(frame, (circle_circle(frame.first, first.radius, frame.second, second.radius, first_is_a),))

    def columns() -> list[jax.Array]:
        keys, first_is_a = [], []
        for i, j in pairs:
            pair = topology.pairs.index((m + i, m + j))
            near = broad_phase.overlap(*(_slice(shape.ball_box, k, k + 1) for k in (i, j)))
            keys.append(jnp.where(near[0], order.moving[pair], KEY_NONE))
            first_is_a.append(order.low_is_a[pair])
        return [jnp.stack(keys), jnp.stack(first_is_a).astype(jnp.int32)]

    bodies = tuple((m + i, m + j) for i, j in pairs)
    first_id = len(topology.ball_bar_pairs)
    return PairType(pairs, bodies, first_id, _info(columns), (shape.balls[:-1], shape.balls), manifold)


def _bar_bar(
    topology: Topology, world: World, shape: Shapes, broad: BroadPhase, order: broad_phase.OrderKeys
) -> PairType | None:
    m, pairs = topology.bars, topology.bar_pairs
    if not pairs:
        return None

    def manifold(first_row: jax.Array, second_row: jax.Array, info: jax.Array, start: jax.Array | None) -> Manifold:
        first, second = shapes.bar(first_row), shapes.bar(second_row)
        frame = _frame(first, second)
        segment = _second_segment(second, frame)
        return Manifold(frame, *segment_segment(first.segment, segment, info[PAIR_FIRST_IS_A] != 0, start))

    def columns() -> list[jax.Array]:
        keys = []
        for bar in range(m):
            others = range(bar + 1, m)
            near = broad_phase.overlap(_slice(shape.bar_box, bar, bar + 1), _slice(shape.bar_box, bar + 1, None))
            keys.append(jnp.where(near & shape.alive[bar + 1 :], order.of(topology, bar, others), KEY_NONE))
        return [jnp.concatenate(keys), _of_bar_pairs(topology, order.low_is_a, broad.updated).astype(jnp.int32)]

    classes = jnp.broadcast_to(world.point_class, (4, len(pairs), *shape.alive.shape[1:]))
    bodies = tuple((i, j if j < m else STATIC_BODY) for i, j in pairs)
    first_id, packed = len(topology.ball_bar_pairs) + len(topology.ball_pairs), _info(columns, *classes)
    tables = (shape.bars[:m], shape.bars)
    return PairType(pairs, bodies, first_id, packed, tables, manifold, two_bars=True, uses_gjk=world.exact)


def _info(columns: Callable[[], list[jax.Array]], *more: jax.Array) -> jax.Array:
    """Return columns and more of them as one table.

    The columns are in memory first: put together in the same loop, they would be scalar code.
    """
    return lanes.stack([*lanes.materialize(columns), *more], axis=1)


def _of_bar_pairs(topology: Topology, of_moving: Sequence[jax.Array], of_body: jax.Array) -> jax.Array:
    """Return values of `topology.bar_pairs`: of two moving bars those of `topology.pairs`, else the moving bar's."""
    values = [
        of_moving[topology.pairs.index((i, j))] if j < topology.bars else of_body[i] for i, j in topology.bar_pairs
    ]
    return jnp.stack(values)


def _slice(box: Box, start: int, stop: int | None) -> Box:
    return jax.tree.map(lambda edge: edge[start:stop], box)


def _frame(first: Ball | Bar, second: Ball | Bar) -> ContactFrame:
    """Return the world frame in float64; in float32 the first body's, with what rounding took from the positions."""
    apart = second.centre - first.centre
    if first.compensation is None or second.compensation is None:
        return ContactFrame(apart, first.centre, second.centre, None)
    apart = apart + (second.compensation - first.compensation)
    return ContactFrame(apart, jax.tree.map(jnp.zeros_like, apart), apart, apart)


def _second_segment(bar: Bar, frame: ContactFrame) -> Segment:
    """Return the core line of a pair's second body, a bar, in the pair's frame."""
    return bar.segment if frame.shift is None else shapes.shifted(bar.segment, frame.shift)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Candidate:
    """A candidate pair; scalars. Found one turn ahead: where it is worked out, rows are read by scalar code."""

    pair: jax.Array  # int32, beyond the last if there is none
    table_rows: tuple[jax.Array, jax.Array]  # int32
    tag: jax.Array  # int32, without the point's id class


def _visit(pair_type: PairType, found: ContactBuffer, gjk_start: jax.Array) -> tuple[ContactBuffer, jax.Array]:
    """Append the touching points of the candidates of one type; `gjk_start` as in `State`."""
    first, second = (np.array([pair[end] for pair in pair_type.pairs], np.int32) for end in range(2))
    ids = 4 * (pair_type.first_id + np.arange(len(pair_type.pairs), dtype=np.int32))
    tags = (ids << 2 * BODY_BITS) | np.array([(one << BODY_BITS) | two for one, two in pair_type.bodies], np.int32)
    Words = tuple[jax.Array, ...]
    Loop = tuple[_Candidate, Words, ContactBuffer, jax.Array]

    def next_candidate(words: Words) -> tuple[_Candidate, Words]:
        pair, words = lanes.take_first(words)
        one, two, tag = lanes.read((jnp.asarray(first), jnp.asarray(second), jnp.asarray(tags)), pair)
        return _Candidate(pair, (one, two), tag), words

    def body(loop: Loop) -> Loop:
        candidate, words, found, gjk_start = loop
        one, two = (lanes.read(table, row) for table, row in zip(pair_type.tables, candidate.table_rows, strict=True))
        info = lanes.read(pair_type.info, candidate.pair)
        start = lanes.read(gjk_start, candidate.pair) if pair_type.uses_gjk else None
        frame, points, end = pair_type.manifold(one, two, info, start)
        if start is not None and end is not None:
            gjk_start = lanes.write(gjk_start, candidate.pair, jnp.where(info[PAIR_KEY] == KEY_NONE, start, end))

        def rows() -> list[tuple[jax.Array, jax.Array, list[jax.Array]]]:
            out = []
            for k, point in enumerate(points):
                key = _key(info, k if pair_type.two_bars else None, point)
                id_class = _id_class(info, point) if pair_type.two_bars else point.id
                out.append((key, candidate.tag + (id_class << 2 * BODY_BITS), point_numbers(frame, point)))
            return out

        for row in lanes.materialize(rows):
            found = found.append(*row)
        return *next_candidate(words), found, gjk_start

    start = next_candidate(lanes.any_lane(pair_type.info[:, PAIR_KEY] != KEY_NONE))
    return jax.lax.while_loop(lambda loop: loop[0].pair < len(pair_type.pairs), body, (*start, found, gjk_start))[2:]


def _key(info: jax.Array, index: int | None, point: ManifoldPoint) -> jax.Array:
    """Return the order key of a point, KEY_NONE if it does not touch.

    index: of two bars, 0 for the first point, 1 for the second; the first point of role a comes first.
    """
    key = info[PAIR_KEY]
    if index is not None:
        key = key | jnp.where(info[PAIR_FIRST_IS_A] != 0, index, 1 - index)
    return jnp.where(point.touching & (info[PAIR_KEY] != KEY_NONE), key, KEY_NONE)


def _id_class(info: jax.Array, point: ManifoldPoint) -> jax.Array:
    """Return the id of a point of two bars, or the lower one that the reference cannot tell from it."""
    return lanes.pick([info[PAIR_POINT_CLASS + k] for k in range(4)], point.id)

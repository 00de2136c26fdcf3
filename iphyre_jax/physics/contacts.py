"""Collision: from shapes to the ordered slots that the solver works through.

Candidate pairs are those whose exact boxes overlap in at least one lane; the loops below visit only these, so a world
pays for what it and its neighbours touch. Touching points take the next free slot of their lane; at the end the slots
are put in order by their keys (see `broad_phase.order`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.physics import broad_phase, gjk, lanes, shapes
from iphyre_jax.physics.narrow_phase import ManifoldPoint, circle_circle, circle_segment, segment_segment
from iphyre_jax.physics.shapes import Ball, Bar, Shapes
from iphyre_jax.physics.types import Box, BroadPhase, Segment, Topology, World
from iphyre_jax.physics.vector import Vec, dot

KEY_NONE = np.int32(2**31 - 1)  # order key of a point that does not touch
BODY_BITS = 4  # of a body in a tag
STATIC_BODY = 2**BODY_BITS - 1
NUMBERS = 7  # of a contact point


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactTable:
    """Contact points as tables: one row a slot."""

    tag: jax.Array  # (K,) int32: id, first body, second body (STATIC_BODY if it does not move); -1 for an empty slot
    numbers: jax.Array  # (K, 7): normal, arm of the first body, arm of the second, distance


@dataclass(frozen=True)
class ContactPoint:
    """One contact point, or all of a table."""

    id: jax.Array  # int32, identity for the contact cache: 4 * pair + id class; negative for none
    first: jax.Array  # int32, moving body
    second: jax.Array  # int32, the other body
    normal: Vec  # unit, from first to second
    arm_first: Vec  # px, from the body's centre to its contact point
    arm_second: Vec
    separation: jax.Array  # px along the normal, negative when overlapping


def unpack(tag: jax.Array, numbers: jax.Array, axis: int = 0) -> ContactPoint:
    """Return a row of `ContactTable`, or with axis 1 the whole table, by the names of its fields."""
    n = [jax.lax.index_in_dim(jnp.asarray(numbers), k, axis, keepdims=False) for k in range(NUMBERS)]
    first, second = (tag >> BODY_BITS) & STATIC_BODY, tag & STATIC_BODY
    return ContactPoint(tag >> 2 * BODY_BITS, first, second, Vec(n[0], n[1]), Vec(n[2], n[3]), Vec(n[4], n[5]), n[6])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactBuffer:
    """Touching points in the order in which they were found."""

    key: jax.Array  # (K,) int32
    tag: jax.Array  # (K,) int32, see `ContactTable`
    numbers: tuple[jax.Array, ...]  # NUMBERS of (K,)
    total: jax.Array  # () int32, points found, which may exceed K


@dataclass(frozen=True)
class ContactFrame:
    """Where the bodies of a pair are in the frame in which their contact is computed."""

    apart: Vec  # px, from the first body's centre to the second's
    first: Vec  # px, centre of the first body
    second: Vec
    shift: Vec | None  # px, takes the second body's bar into the frame; None: it is there


Touches = tuple[ContactFrame, tuple[ManifoldPoint, ...], jax.Array | None]  # last: float64, two bars: the nearest side


@dataclass(frozen=True)
class PairType:
    """One kind of pair: its candidates, and how to find their contact points."""

    pairs: tuple[tuple[int, int], ...]  # rows of the two tables
    bodies: tuple[tuple[int, int], ...]  # moving body, or STATIC_BODY
    first_id: int
    info: jax.Array  # (pairs, 1, 2 or 6) int32: key; with two balls or bars whether the first has role a; id classes
    tables: tuple[jax.Array, jax.Array]  # two arrays: two rows of one array would be read in one loop, of scalar code
    touch: Callable[
        [jax.Array, jax.Array, jax.Array, jax.Array | None], Touches
    ]  # rows of tables, info and `gjk_start`


def collide(
    topology: Topology, world: World, shape: Shapes, broad: BroadPhase, gjk_start: jax.Array
) -> tuple[ContactTable, jax.Array, jax.Array]:
    """Return the touching points of every lane in solve order, (K,) rows, and how many there are (it may exceed K).

    Last is the new value of `gjk_start`, see `State.gjk_start`.
    """
    order = broad_phase.order(topology, world, broad)
    found, none = _empty(topology.slots, shape.balls[0, 0]), gjk_start[:0]
    for pair_type in (_ball_bar(topology, shape, order), _ball_ball(topology, shape, order)):
        if pair_type is not None:
            found, _ = _visit(pair_type, found, none)
    bars = _bar_bar(topology, world, shape, broad, order)
    if bars is not None and gjk_start.shape[0] == 0:
        found, _ = _visit(bars, found, none)
    elif bars is not None:
        # A new pair remembers no side; if its owner inserted it, the reference also forgets the one found in this step.
        renewed = [broad.updated[i] | broad.updated[j] for i, j in topology.pairs]
        gjk_start = jnp.where(_of_bar_pairs(topology, renewed, broad.updated), gjk.NO_SIDE, gjk_start)
        found, gjk_start = _visit(bars, found, gjk_start)
        gjk_start = jnp.where(_of_bar_pairs(topology, order.by_owner, broad.updated), gjk.NO_SIDE, gjk_start)
    return _in_order(found), found.total, gjk_start


def _ball_bar(topology: Topology, shape: Shapes, order: broad_phase.OrderKeys) -> PairType:
    m, pairs = topology.bars, topology.ball_bar_pairs

    def touch(ball_row: jax.Array, bar_row: jax.Array, *_: jax.Array | None) -> Touches:
        ball, bar = shapes.ball(ball_row), shapes.bar(bar_row)
        frame = _frame(ball, bar)
        return frame, (circle_segment(frame.first, ball.radius, _second_segment(bar, frame)),), None

    keys = []
    for ball in range(topology.balls):
        near = broad_phase.overlap(_slice(shape.ball_box, ball, ball + 1), shape.bar_box) & shape.alive
        keys.append(jnp.where(near, order.of(topology, m + ball, range(m)), KEY_NONE))
    bodies = tuple((m + i, j if j < m else STATIC_BODY) for i, j in pairs)
    return PairType(pairs, bodies, 0, jnp.concatenate(keys)[:, None], (shape.balls, shape.bars), touch)


def _ball_ball(topology: Topology, shape: Shapes, order: broad_phase.OrderKeys) -> PairType | None:
    m, pairs = topology.bars, topology.ball_pairs
    if not pairs:
        return None

    def touch(first_row: jax.Array, second_row: jax.Array, info: jax.Array, _: jax.Array | None) -> Touches:
        first, second = shapes.ball(first_row), shapes.ball(second_row)
        frame = _frame(first, second)
        return frame, (circle_circle(frame.first, first.radius, frame.second, second.radius, info[1] != 0),), None

    keys, first_is_a = [], []
    for i, j in pairs:
        pair = topology.pairs.index((m + i, m + j))
        near = broad_phase.overlap(*(_slice(shape.ball_box, k, k + 1) for k in (i, j)))
        keys.append(jnp.where(near[0], order.moving[pair], KEY_NONE))
        first_is_a.append(order.low_is_a[pair])
    info = [jnp.stack(keys), jnp.stack(first_is_a).astype(jnp.int32)]
    bodies = tuple((m + i, m + j) for i, j in pairs)
    first_id = len(topology.ball_bar_pairs)
    return PairType(pairs, bodies, first_id, lanes.stack(info, axis=1), (shape.balls[:-1], shape.balls), touch)


def _bar_bar(
    topology: Topology, world: World, shape: Shapes, broad: BroadPhase, order: broad_phase.OrderKeys
) -> PairType | None:
    m, pairs = topology.bars, topology.bar_pairs
    if not pairs:
        return None

    def touch(first_row: jax.Array, second_row: jax.Array, info: jax.Array, gjk_start: jax.Array | None) -> Touches:
        first, second = shapes.bar(first_row), shapes.bar(second_row)
        frame = _frame(first, second)
        return frame, *segment_segment(first.segment, _second_segment(second, frame), info[1] != 0, gjk_start)

    keys = []
    for bar in range(m):
        others = range(bar + 1, m)
        near = broad_phase.overlap(_slice(shape.bar_box, bar, bar + 1), _slice(shape.bar_box, bar + 1, None))
        keys.append(jnp.where(near & shape.alive[bar + 1 :], order.of(topology, bar, others), KEY_NONE))
    info = [
        jnp.concatenate(keys),
        _of_bar_pairs(topology, order.low_is_a, broad.updated).astype(jnp.int32),
        *jnp.broadcast_to(world.point_class, (4, len(pairs), *shape.alive.shape[1:])),
    ]
    bodies = tuple((i, j if j < m else STATIC_BODY) for i, j in pairs)
    first_id = len(topology.ball_bar_pairs) + len(topology.ball_pairs)
    return PairType(pairs, bodies, first_id, lanes.stack(info, axis=1), (shape.bars[:m], shape.bars), touch)


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


def _empty(slots: int, like: jax.Array) -> ContactBuffer:
    whole = jnp.zeros((slots, *like.shape), jnp.int32)
    return ContactBuffer(whole + KEY_NONE, whole - 1, (whole.astype(like.dtype),) * NUMBERS, jnp.zeros_like(whole[0]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Candidate:
    """A candidate pair; scalars. Found one turn ahead: where it is worked out, rows are read by scalar code."""

    pair: jax.Array  # int32, beyond the last if there is none
    table_rows: tuple[jax.Array, jax.Array]  # int32
    tag: jax.Array  # int32, without the point's id class


def _visit(pair_type: PairType, found: ContactBuffer, gjk_start: jax.Array) -> tuple[ContactBuffer, jax.Array]:
    """Append the touching points of the candidates of one kind; `gjk_start` as in `State`."""
    first, second = (np.array([pair[end] for pair in pair_type.pairs], np.int32) for end in range(2))
    ids = 4 * (pair_type.first_id + np.arange(len(pair_type.pairs), dtype=np.int32))
    tags = (ids << 2 * BODY_BITS) | np.array([(one << BODY_BITS) | two for one, two in pair_type.bodies], np.int32)
    Words = tuple[jax.Array, ...]
    Loop = tuple[_Candidate, Words, ContactBuffer, jax.Array]

    def following(words: Words) -> tuple[_Candidate, Words]:
        pair, words = lanes.take_first(words)
        one, two, tag = lanes.read((jnp.asarray(first), jnp.asarray(second), jnp.asarray(tags)), pair)
        return _Candidate(pair, (one, two), tag), words

    def body(loop: Loop) -> Loop:
        candidate, words, found, gjk_start = loop
        one, two = (lanes.read(table, row) for table, row in zip(pair_type.tables, candidate.table_rows, strict=True))
        info = lanes.read(pair_type.info, candidate.pair)
        before = lanes.read(gjk_start, candidate.pair) if gjk_start.shape[0] else None
        frame, touches, after = pair_type.touch(one, two, info, before)
        if before is not None and after is not None:
            gjk_start = lanes.write(gjk_start, candidate.pair, jnp.where(info[0] == KEY_NONE, before, after))
        for end, touch in enumerate(touches):
            key = _key(info, end if len(touches) > 1 else None, touch)
            tag = candidate.tag + (_id_class(info, touch) << 2 * BODY_BITS)
            found = _append(found, key, tag, frame, touch)
        return *following(words), found, gjk_start

    start = following(lanes.any_lane(pair_type.info[:, 0] != KEY_NONE))
    return jax.lax.while_loop(lambda loop: loop[0].pair < len(pair_type.pairs), body, (*start, found, gjk_start))[2:]


def _key(info: jax.Array, end: int | None, touch: ManifoldPoint) -> jax.Array:
    """Return the order key of a point, KEY_NONE if it does not touch. Of two bars the first point of a comes first."""
    key = info[0]
    if end is not None:
        key = key | jnp.where(info[1] != 0, end, 1 - end)
    return jnp.where(touch.touching & (info[0] != KEY_NONE), key, KEY_NONE)


def _id_class(info: jax.Array, touch: ManifoldPoint) -> jax.Array:
    """Return the id of a point of two bars, or the lower one that the reference cannot tell from it."""
    return touch.id if info.shape[0] < 6 else lanes.pick([info[2 + k] for k in range(4)], touch.id)


def _append(
    found: ContactBuffer, key: jax.Array, tag: jax.Array, frame: ContactFrame, touch: ManifoldPoint
) -> ContactBuffer:
    """Give a point the next free slot of its lane; beyond the last one it is only counted."""
    touching = key != KEY_NONE
    arm_first, arm_second = touch.on_first - frame.first, touch.on_second - frame.second
    separation = dot((arm_second - arm_first) + frame.apart, touch.normal)
    vectors = (touch.normal, arm_first, arm_second)
    numbers = [*(part for vec in vectors for part in (vec.x, vec.y)), separation]
    here = (lanes.iota(found.key.shape[0], key) == found.total[None]) & touching[None]
    old = (found.key, found.tag, *found.numbers)
    rows = [jnp.where(here, new[None], kept) for new, kept in zip((key, tag, *numbers), old, strict=True)]
    return ContactBuffer(rows[0], rows[1], tuple(rows[2:]), found.total + touching.astype(jnp.int32))


def _in_order(found: ContactBuffer) -> ContactTable:
    """Return the points in the order of their keys."""
    size = found.key.shape[0]
    num_active = jnp.minimum(jnp.max(found.total), size)
    rank = lanes.visit(
        found.key,
        num_active,
        lambda _, key, rank: rank + (key[None] < found.key).astype(jnp.int32),
        jnp.zeros_like(found.key),
    )
    index = lanes.iota(size, found.total)

    def put(_: jax.Array, row: tuple[jax.Array, ContactTable], points: ContactTable) -> ContactTable:
        rank, point = row
        here = index == rank[None]
        tag = jnp.where(here, point.tag[None], points.tag)
        return ContactTable(tag, jnp.where(here[:, None], point.numbers[None], points.numbers))

    numbers = lanes.stack(found.numbers, axis=1)
    empty = ContactTable(jnp.full_like(found.tag, -1), jnp.zeros_like(numbers))
    return lanes.visit((rank, ContactTable(found.tag, numbers)), num_active, put, empty)

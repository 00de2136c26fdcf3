"""The reference's broad phase, reduced to what it decides: the order in which touching pairs are solved.

The reference keeps moving shapes in a tree of fat boxes. It keeps every pair of overlapping boxes in linked lists, and
rebuilds a shape's lists only when the shape leaves its fat box. So the solve order follows from three facts about each
body: its position in the tree (path bits), whether it was re-inserted in this step, and when each of its pairs was last
inserted (counters).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes
from iphyre_jax.physics.constants import FAT_MARGIN
from iphyre_jax.physics.order_keys import COUNTER_START, STATIC_RANKS, OrderKeyLayout
from iphyre_jax.physics.types import Box, BroadPhase, Topology, World
from iphyre_jax.physics.vector import Vec, product


def overlap(a: Box, b: Box) -> jax.Array:
    """Return whether boxes overlap, touching included."""
    return (a.left <= b.right) & (b.left <= a.right) & (a.top <= b.bottom) & (b.top <= a.bottom)


def contains(outer: Box, inner: Box) -> jax.Array:
    """Return whether `outer` contains `inner`, border included."""
    return (
        (outer.left <= inner.left)
        & (outer.right >= inner.right)
        & (outer.top <= inner.top)
        & (outer.bottom >= inner.bottom)
    )


def grow(box: Box, velocity: Vec) -> Box:
    """Return fat boxes: exact boxes with a margin: a tenth of their size, and a tenth of a second of motion ahead."""
    margin = jnp.array(FAT_MARGIN, box.left.dtype)
    width, height = product(box.right - box.left, margin), product(box.bottom - box.top, margin)
    ahead = velocity * margin
    return Box(
        box.left + jnp.minimum(-width, ahead.x),
        box.top + jnp.minimum(-height, ahead.y),
        box.right + jnp.maximum(width, ahead.x),
        box.bottom + jnp.maximum(height, ahead.y),
    )


def update(topology: Topology, world: World, broad: BroadPhase, box: Box, velocity: Vec, step: jax.Array) -> BroadPhase:
    """Re-insert every moving body that has left its fat box and renew the counters of its pairs.

    box: (n,) exact boxes of the moving bodies; velocity: theirs, of the step before.
    """
    outside = ~contains(broad.fat, box)
    fat = jax.tree.map(lambda new, old: jnp.where(outside, new, old), grow(box, velocity), broad.fat)
    layout = OrderKeyLayout(topology.moving)
    base = COUNTER_START + step * layout.per_step
    if topology.moving == 1:
        inserted = jnp.where(outside, jnp.expand_dims(base, 0), broad.inserted)
        return replace(broad, fat=fat, inserted=inserted, updated=outside)

    def reinsert(_: None) -> BroadPhase:
        path, depth = _move_leaves(topology, world, broad, fat, outside)
        rank = ranks(path)
        inserted = jnp.where(outside, jnp.expand_dims(base, 0) + rank * layout.per_rank, broad.inserted)
        pair_counter = _count_pairs(topology, layout, base, path, rank, outside, broad.pair_counter)
        return BroadPhase(fat, path, depth, inserted, pair_counter, outside)

    unchanged = replace(broad, fat=fat, updated=outside)
    return jax.lax.cond(lanes.any_set(lanes.any_lane(outside)), reinsert, lambda _: unchanged, None)


def ranks(path: jax.Array) -> jax.Array:
    """Return each body's rank in the depth-first order of the tree, (n,) int32."""
    before = [
        sum((path[j] < path[i]).astype(jnp.int32) for j in range(path.shape[0]) if j != i) for i in range(path.shape[0])
    ]
    return jnp.stack([jnp.asarray(count, jnp.int32) for count in before])


def _bit_length(value: jax.Array) -> jax.Array:
    return 32 - jax.lax.clz(value)


def _count_pairs(
    topology: Topology,
    layout: OrderKeyLayout,
    base: jax.Array,
    path: jax.Array,
    rank: jax.Array,
    outside: jax.Array,
    old: jax.Array,
) -> jax.Array:
    """Return the counters of the pairs of moving bodies, renewed where either was re-inserted in this step.

    The pair is inserted by the re-inserted body of the lower rank; nearer relatives in the tree come later.
    """
    rows = []
    for p, (i, j) in enumerate(topology.pairs):
        i_low = rank[i] < rank[j]
        by_i = jnp.where(i_low, outside[i], ~outside[j])
        mine, other = jnp.where(by_i, rank[i], rank[j]), jnp.where(by_i, rank[j], rank[i])
        position = STATIC_RANKS + _bit_length(path[i] ^ path[j]) * layout.moving + other
        rows.append(jnp.where(outside[i] | outside[j], base + mine * layout.per_rank + position, old[p]))
    return jnp.stack(rows)


def _move_leaves(
    topology: Topology, world: World, broad: BroadPhase, fat: Box, outside: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Remove and insert the bodies that left their boxes, one after another in leaf order; return (path, depth)."""
    n, like = topology.moving, outside[0]
    index = lanes.iota(n, like)
    places = (jnp.where(index == jnp.expand_dims(world.leaf_order[q], 0), q, 0) for q in range(n))
    place = sum(places, jnp.int32(0))  # of each body in that order

    def move(turn: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        path, depth = carry
        me = place == turn
        moved = jnp.any(me & outside, axis=0, keepdims=True)
        # Those that had their turn are in their new boxes.
        boxes = jax.tree.map(lambda new, old: jnp.where(outside & (place <= turn), new, old), fat, broad.fat)
        removed = lanes.materialize(lambda: _remove(n, me, path, depth))

        def inserted() -> tuple[jax.Array, jax.Array]:
            new_path, new_depth = _insert(n, me, boxes, *removed)
            return jnp.where(moved, new_path, path), jnp.where(moved, new_depth, depth)

        return lanes.materialize(inserted)

    turns = jnp.stack([jnp.any((place == q) & outside, axis=0) for q in range(n)])
    return lanes.visit_any(turns, move, (broad.path, broad.depth))


def _of(me: jax.Array, values: jax.Array) -> jax.Array:
    """Return the value of the one body marked in `me`, row axis kept."""
    return jnp.sum(jnp.where(me, values, 0), axis=0, keepdims=True, dtype=values.dtype)


def _remove(n: int, me: jax.Array, path: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Take one leaf out of the tree: those under its sibling lose the bit that told them apart from it."""
    bits = n - 1
    level = _of(me, depth) - 1  # the leaf's own last bit
    below = bits - level  # bits from that level down
    relative = ((path ^ _of(me, path)) >> below) == 0
    low = (jnp.int32(1) << (below - 1)) - 1
    shortened = (path >> below << below) | ((path & low) << 1)
    under = relative & ~me
    return jnp.where(under, shortened, path), jnp.where(under, depth - 1, depth)


def _insert(n: int, me: jax.Array, boxes: Box, path: jax.Array, depth: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Put one leaf into the tree of the others by the greedy rule: down to a leaf, whose sibling it becomes."""
    bits = n - 1
    mine = jax.tree.map(lambda leaf: _of(me, leaf), boxes)
    inside = ~me
    my_path = jnp.zeros_like(path[:1])
    my_depth = jnp.zeros_like(depth[:1])
    for level in range(bits - 1):  # the last level never holds two candidates
        open_ = jnp.sum(inside, axis=0, keepdims=True, dtype=jnp.int32) > 1
        bit = ((path >> (bits - 1 - level)) & 1) == 1
        second = lanes.materialize(partial(_goes_second, inside & ~bit, inside & bit, boxes, mine))
        my_path = jnp.where(open_ & second, my_path | (1 << (bits - 1 - level)), my_path)
        my_depth = jnp.where(open_, level + 1, my_depth)
        inside = jnp.where(open_, inside & (bit == second), inside)
    new_bit = jnp.int32(1) << (bits - 1 - my_depth)
    path = jnp.where(inside, path | new_bit, jnp.where(me, my_path, path))
    return path, jnp.where(inside | me, my_depth + 1, depth)


def _goes_second(first: jax.Array, second: jax.Array, boxes: Box, mine: Box) -> jax.Array:
    """Return whether a new leaf goes into the second subtree: least growth of area, then nearness, then the first."""
    a, b = _hull(first, boxes), _hull(second, boxes)
    cost_a = _area(b) + _area(_union(a, mine))
    cost_b = _area(a) + _area(_union(b, mine))
    tie = cost_a == cost_b
    return jnp.where(tie, _proximity(b, mine) < _proximity(a, mine), cost_b < cost_a)


def _hull(members: jax.Array, boxes: Box) -> Box:
    """Return the box around the marked ones, row axis kept."""
    far = jnp.array(jnp.inf, boxes.left.dtype)
    return Box(
        jnp.min(jnp.where(members, boxes.left, far), axis=0, keepdims=True),
        jnp.min(jnp.where(members, boxes.top, far), axis=0, keepdims=True),
        jnp.max(jnp.where(members, boxes.right, -far), axis=0, keepdims=True),
        jnp.max(jnp.where(members, boxes.bottom, -far), axis=0, keepdims=True),
    )


def _union(a: Box, b: Box) -> Box:
    return Box(
        jnp.minimum(a.left, b.left),
        jnp.minimum(a.top, b.top),
        jnp.maximum(a.right, b.right),
        jnp.maximum(a.bottom, b.bottom),
    )


def _area(a: Box) -> jax.Array:
    return product(a.right - a.left, a.bottom - a.top)


def _proximity(a: Box, b: Box) -> jax.Array:
    return jnp.abs(a.left + a.right - b.left - b.right) + jnp.abs(a.top + a.bottom - b.top - b.bottom)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OrderKeys:
    """Order keys: of two touching pairs of a world, the one with the lower key is solved first. Keys are even."""

    static: jax.Array  # (n, S) int32, pairs of a moving body and a static bar
    moving: tuple[jax.Array, ...]  # () int32 for each of `topology.pairs`
    low_is_a: tuple[jax.Array, ...]  # () bool, whether the lower index of the pair has role a
    by_owner: tuple[jax.Array, ...]  # () bool, whether the pair's owner was re-inserted in this step

    def of(self, topology: Topology, body: int, others: Sequence[int]) -> jax.Array:
        """Return the keys of a body's pairs with some moving bodies, then with all static bars, (others + S,)."""
        pairs = [topology.pairs.index((min(body, other), max(body, other))) for other in others]
        return jnp.concatenate([*(self.moving[p][None] for p in pairs), self.static[body]])


def order(topology: Topology, world: World, broad: BroadPhase) -> OrderKeys:
    """Return the order keys of all pairs.

    Of two moving bodies, the one of the higher rank owns the pair. On the step of its owner's re-insertion, static bars
    come first, by rank, then moving bodies, and the owner has role a. Otherwise the pair inserted last comes first, and
    the owner has role b.
    """
    c = OrderKeyLayout(topology.moving)
    rank = ranks(broad.path) if topology.moving > 1 else jnp.zeros_like(broad.path)
    static_rank = lanes.iota(topology.num_static, rank[0])[None]
    inserted, updated = broad.inserted[:, None], broad.updated[:, None]
    first = world.static_counter.reshape(topology.moving, topology.num_static, *rank.shape[1:])
    counter = jnp.where(inserted < 0, first, inserted + static_rank)
    static = ((rank[:, None] << c.inner_bits) | jnp.where(updated, static_rank, c.newest - counter)) << 1
    moving, low_is_a, by_owner = [], [], []
    for p, (i, j) in enumerate(topology.pairs):
        i_owns = rank[i] > rank[j]
        fresh = jnp.where(i_owns, broad.updated[i], broad.updated[j])
        owner, other = jnp.where(i_owns, rank[i], rank[j]), jnp.where(i_owns, rank[j], rank[i])
        by_tree = STATIC_RANKS + _bit_length(broad.path[i] ^ broad.path[j]) * c.moving + other
        inner = jnp.where(fresh, by_tree, c.newest - broad.pair_counter[p])
        moving.append(((owner << c.inner_bits) | inner) << 1)
        low_is_a.append(i_owns == fresh)
        by_owner.append(fresh)
    return OrderKeys(static, tuple(moving), tuple(low_is_a), tuple(by_owner))

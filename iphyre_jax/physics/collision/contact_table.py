"""The contact points of a step: appended lane by lane as they are found, then put into solve order."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.physics import lanes
from iphyre_jax.physics.collision.narrow_phase import ManifoldPoint
from iphyre_jax.physics.tables import POINT_ARM_FIRST, POINT_ARM_SECOND, POINT_NORMAL, POINT_SEPARATION, POINT_WIDTH
from iphyre_jax.physics.vector import Vec, dot

KEY_NONE = np.int32(2**31 - 1)  # order key of a point that does not touch
BODY_BITS = 4  # of a body in a tag
STATIC_BODY = 2**BODY_BITS - 1


@dataclass(frozen=True)
class ContactFrame:
    """Where the bodies of a pair are in the frame in which their contact is computed."""

    apart: Vec  # px, from the first body's centre to the second's
    first: Vec  # px, centre of the first body
    second: Vec
    shift: Vec | None  # px, takes the second body's bar into the frame; None: it is there


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


def point_numbers(frame: ContactFrame, point: ManifoldPoint) -> list[jax.Array]:
    """Return the numbers of a point in a table, as `tables.POINT_NORMAL` and those after it."""
    arm_first, arm_second = point.on_first - frame.first, point.on_second - frame.second
    separation = dot((arm_second - arm_first) + frame.apart, point.normal)
    vectors = (point.normal, arm_first, arm_second)
    return [*(part for vec in vectors for part in (vec.x, vec.y)), separation]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactTable:
    """Packed contact points, one row a slot."""

    tag: jax.Array  # (K,) int32: id, first body, second body (STATIC_BODY if it does not move); -1 for an empty slot
    numbers: jax.Array  # (K, POINT_WIDTH)

    def unpack(self, axis: int = 0) -> ContactPoint:
        """Return a row of the table, or with axis 1 the whole table, by the names of its fields."""
        n = [jax.lax.index_in_dim(jnp.asarray(self.numbers), k, axis, keepdims=False) for k in range(POINT_WIDTH)]
        first, second = (self.tag >> BODY_BITS) & STATIC_BODY, self.tag & STATIC_BODY
        normal, one, two = (Vec(n[k], n[k + 1]) for k in (POINT_NORMAL, POINT_ARM_FIRST, POINT_ARM_SECOND))
        return ContactPoint(self.tag >> 2 * BODY_BITS, first, second, normal, one, two, n[POINT_SEPARATION])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactBuffer:
    """Touching points in the order in which they were found; slots that no point has are `lanes.blank`."""

    key: jax.Array  # (K,) int32
    tag: jax.Array  # (K,) int32, see `ContactTable`
    numbers: tuple[jax.Array, ...]  # POINT_WIDTH of (K,)
    total: jax.Array  # () int32, points found, which may exceed K

    @classmethod
    def empty(cls, slots: int, like: jax.Array) -> ContactBuffer:
        """Return a buffer without points; like: a number of one lane each."""
        whole = jnp.zeros((slots, *like.shape), jnp.int32)
        tags, numbers = lanes.blank(whole), lanes.blank(whole.astype(like.dtype))
        return cls(tags, tags, (numbers,) * POINT_WIDTH, whole[0])

    def append(self, key: jax.Array, tag: jax.Array, numbers: list[jax.Array]) -> ContactBuffer:
        """Give a point the next free slot of its lane, unless its key is KEY_NONE; beyond the last only count it."""
        touching = key != KEY_NONE
        slot = lanes.materialize(lambda: jnp.where(touching, self.total, -1))
        here = lanes.iota(self.key.shape[0], key) == slot[None]
        old = (self.key, self.tag, *self.numbers)
        rows = [lanes.fill(kept, here, new[None]) for new, kept in zip((key, tag, *numbers), old, strict=True)]
        return ContactBuffer(rows[0], rows[1], tuple(rows[2:]), self.total + touching.astype(jnp.int32))

    def in_order(self) -> ContactTable:
        """Return the points in the order of their keys."""
        size = self.key.shape[0]
        num_active = jnp.minimum(jnp.max(self.total), size)
        index = lanes.iota(size, self.total)
        in_use = index < self.total[None]
        own = jnp.where(in_use, self.key, KEY_NONE)
        rank = lanes.visit(
            own,
            num_active,
            lambda _, key, rank: rank + (key[None] < own).astype(jnp.int32),
            jnp.zeros_like(own),
        )

        def put(_: jax.Array, row: tuple[jax.Array, ContactTable], table: ContactTable) -> ContactTable:
            rank, point = row
            here = index == rank[None]
            tag = lanes.fill(table.tag, here, point.tag[None])
            return ContactTable(tag, lanes.fill(table.numbers, here[:, None], point.numbers[None]))

        numbers = lanes.stack(self.numbers, axis=1)
        empty = ContactTable(lanes.blank(self.tag), lanes.blank(numbers))
        table = lanes.visit((rank, ContactTable(self.tag, numbers)), num_active, put, empty)
        return ContactTable(jnp.where(in_use, table.tag, -1), jnp.where(in_use[:, None], table.numbers, 0))

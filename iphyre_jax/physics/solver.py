"""Contact solver: pre-step, cached impulses and the sweeps over slots, as the reference's arbiters do it.

A contact is one row of a table. Which bodies it joins differs from lane to lane, so the row holds for every moving
body a sign, -1 for the first body, 1 for the second, 0 for the others, and its arm times that sign; all masses are 1.
Then relative velocity = sum sign v + perp(signed arm) w, and an impulse j changes v by sign j and w by
cross(signed arm, j) / I, without choosing bodies. The signs are exact, so nothing is rounded otherwise than in the
reference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.physics import joints, lanes
from iphyre_jax.physics.constants import FRICTION, MASS, PERSISTENCE, RESTITUTION, SLOP, SWEEPS
from iphyre_jax.physics.contacts import STATIC_BODY, Point, Points, unpack
from iphyre_jax.physics.types import Cache, Motion, Timing, Topology, World
from iphyre_jax.physics.vector import Vec, cross, dot, perp, product, rotate, where


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contacts:
    """The contact points of a step in solve order, (K,) rows."""

    points: Points
    fixed: jax.Array  # (K, fields), see `Contact`
    impulses: jax.Array  # (K, 3) accumulated: normal, tangent, bias, px/s
    continuing: jax.Array  # (K,) bool, touched in the step before


@dataclass(frozen=True)
class Contact:
    """What the sweeps need of a contact point, or of all of a table."""

    normal: Vec
    normal_mass: jax.Array
    tangent_mass: jax.Array
    bias: jax.Array  # px/s, wanted speed of separation along the normal
    bounce: jax.Array  # px/s
    sign: tuple[jax.Array, ...]  # one a moving body; none where there is only one, which is always the first
    arm: tuple[Vec, ...]  # px, one a moving body, times the sign

    def pack(self) -> jax.Array:
        """Return the fields as rows of one array."""
        own = [self.normal.x, self.normal.y, self.normal_mass, self.tangent_mass, self.bias, self.bounce]
        return lanes.stack([*own, *self.sign, *(part for arm in self.arm for part in (arm.x, arm.y))])


def fields(moving: int) -> int:
    """Return how many numbers a contact has."""
    return 8 if moving == 1 else 6 + 3 * moving


def unpack_contact(fixed: jax.Array, moving: int, axis: int = 0) -> Contact:
    """Return a row of `Contacts.fixed`, or with axis 1 the whole table, by the names of its fields."""
    n = [jax.lax.index_in_dim(jnp.asarray(fixed), k, axis, keepdims=False) for k in range(fixed.shape[axis])]
    signs = () if moving == 1 else tuple(n[6 : 6 + moving])
    arms = n[6 + len(signs) :]
    vectors = tuple(Vec(*arms[k : k + 2]) for k in range(0, 2 * moving, 2))
    return Contact(Vec(n[0], n[1]), n[2], n[3], n[4], n[5], signs, vectors)


def recall(cache: Cache, point: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (continuing, normal impulse, tangent impulse) of a contact point from the last three steps.

    The newest step in which the pair touched counts, even if this very point is not in it; the last equal point wins.
    Impulses that are two or three steps old are taken over but not applied (`continuing` is False).
    """
    found, continuing = jnp.zeros_like(point, bool), jnp.zeros_like(point, bool)
    normal = tangent = jnp.zeros_like(cache.normal_impulse[0, 0])
    for age in range(PERSISTENCE):
        same_pair, here = jnp.zeros_like(point, bool), ~found
        for k in range(cache.point.shape[1]):
            stored = cache.point[age, k]
            match = (stored == point) & here
            same_pair = same_pair | ((stored >> 2) == (point >> 2))
            normal = jnp.where(match, cache.normal_impulse[age, k], normal)
            tangent = jnp.where(match, cache.tangent_impulse[age, k], tangent)
        continuing = same_pair if age == 0 else continuing
        found = found | same_pair
    return continuing, normal, tangent


def remember(cache: Cache, contacts: Contacts) -> Cache:
    """Return the cache with this step's points in front and the oldest step dropped."""
    ids = unpack(contacts.points.tag, contacts.points.numbers, axis=1).id
    newest = Cache(ids, contacts.impulses[:, 0], contacts.impulses[:, 1])
    return jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), newest, cache)


def unstack(motion: Motion, moving: int) -> list[Motion]:
    """Return the bodies' motions as a list."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], motion) for i in range(moving)]


def stack(motions: list[Motion]) -> Motion:
    """Return a list of motions as rows."""
    return jax.tree.map(lambda *rows: jnp.stack(rows), *motions)


def prestep(
    world: World, timing: Timing, points: Points, used: jax.Array, motions: list[Motion], cache: Cache
) -> Contacts:
    """Return the contacts of a step: masses, wanted speeds and recalled impulses, from the velocities as they are.

    used: number of slots in use in any lane.
    """
    moving, like = len(motions), points.numbers[:, 0]
    empty = Contacts(
        points,
        jnp.zeros((like.shape[0], fields(moving), *like.shape[1:]), like.dtype),
        jnp.zeros((like.shape[0], 3, *like.shape[1:]), like.dtype),
        jnp.zeros_like(like, bool),
    )

    def prepare(k: jax.Array, row: Points, contacts: Contacts) -> Contacts:
        point = unpack(row.tag, row.numbers)
        continuing, normal, tangent = recall(cache, point.id)
        impulses = lanes.stack([normal, tangent, jnp.zeros_like(normal)])
        new = Contacts(row, _prepare(world, timing, point, motions).pack(), impulses, continuing)
        return lanes.write(contacts, k, new)

    return lanes.visit(points, used, prepare, empty)


def _prepare(world: World, timing: Timing, point: Point, motions: list[Motion]) -> Contact:
    """Return a contact point's masses and wanted speeds.

    normal mass 1 / sum(1/m + (r x n)^2 / I), tangent mass the same with the tangent; bias speed
    -bias min(0, distance + slop) / dt; bounce = restitution * relative normal speed, never limited.
    """
    moment = [world.inv_moment[i] for i in range(len(motions))]
    inv_first, inv_second = lanes.pick(moment, point.first), lanes.pick(moment, point.second)
    inv_mass_second = jnp.where(point.second == STATIC_BODY, 0, jnp.array(1.0 / MASS, inv_first.dtype))
    masses = []
    for axis in (point.normal, perp(point.normal)):
        turn_first, turn_second = cross(point.arm_first, axis), cross(point.arm_second, axis)
        total = 1.0 / MASS + product(product(inv_first, turn_first), turn_first)
        total = total + (inv_mass_second + product(product(inv_second, turn_second), turn_second))
        masses.append(1.0 / total)
    bias = product(-timing.bias, jnp.minimum(point.distance + SLOP, 0)) / timing.dt
    contact = Contact(point.normal, masses[0], masses[1], bias, bias, *_signed(point, len(motions)))
    approach = dot(_relative(contact, motions), point.normal)
    return replace(contact, bounce=product(approach, jnp.array(RESTITUTION, approach.dtype)))


def _signed(point: Point, moving: int) -> tuple[tuple[jax.Array, ...], tuple[Vec, ...]]:
    """Return the signs and the signed arms of the bodies."""
    if moving == 1:
        return (), (-point.arm_first,)
    signs, arms, zero = [], [], jnp.zeros_like(point.distance)
    for body in range(moving):
        first, second = point.first == body, point.second == body
        signs.append(jnp.where(second, 1, jnp.where(first, -1, zero)))
        arms.append(where(second, point.arm_second, where(first, -point.arm_first, Vec(zero, zero))))
    return tuple(signs), tuple(arms)


def _relative(contact: Contact, motions: list[Motion], *, bias: bool = False) -> Vec:
    """Return the velocity, or bias velocity, of the second contact point against the first."""
    total: Vec | None = None
    for k, (motion, arm) in enumerate(zip(motions, contact.arm, strict=True)):
        velocity, angular = (motion.bias_velocity, motion.bias_angular) if bias else (motion.velocity, motion.angular)
        own = _times(contact, k, velocity)
        own = Vec(own.x - product(arm.y, angular), own.y + product(arm.x, angular))
        total = own if total is None else total + own
    assert total is not None  # noqa: S101  a world without moving bodies is not valid
    return total


def _times(contact: Contact, body: int, vec: Vec) -> Vec:
    """Return the sign of a body times a vector, which rounds nothing."""
    if not contact.sign:
        return -vec
    return Vec(contact.sign[body] * vec.x, contact.sign[body] * vec.y)


def _apply(world: World, contact: Contact, motions: list[Motion], impulse: Vec, push: Vec | None) -> list[Motion]:
    """Give the bodies an impulse, and a bias impulse, at a contact point."""
    out = []
    for k, (motion, arm) in enumerate(zip(motions, contact.arm, strict=True)):
        spin = motion.angular + product(world.inv_moment[k], cross(arm, impulse))
        motion = replace(motion, velocity=motion.velocity + _times(contact, k, impulse), angular=spin)
        if push is not None:
            spin = motion.bias_angular + product(world.inv_moment[k], cross(arm, push))
            motion = replace(motion, bias_velocity=motion.bias_velocity + _times(contact, k, push), bias_angular=spin)
        out.append(motion)
    return out


def apply_cached(world: World, contacts: Contacts, used: jax.Array, motions: list[Motion]) -> list[Motion]:
    """Give the bodies the impulses of contacts that continue from the step before, in solve order."""

    def apply(_: jax.Array, row: tuple[jax.Array, jax.Array, jax.Array], motions: list[Motion]) -> list[Motion]:
        fixed, impulses, continuing = row
        contact = unpack_contact(fixed, len(motions))
        impulse = rotate(contact.normal, Vec(impulses[0], impulses[1]))
        impulse = where(continuing, impulse, Vec(jnp.zeros_like(impulse.x), jnp.zeros_like(impulse.y)))
        return _apply(world, contact, motions, impulse, None)

    return lanes.visit((contacts.fixed, contacts.impulses, contacts.continuing), used, apply, motions)


def _solve_point(
    world: World, contact: Contact, impulses: jax.Array, motions: list[Motion]
) -> tuple[jax.Array, list[Motion]]:
    """Solve one contact point: all three impulses from velocities read before any of them is applied."""
    bias_speed = dot(_relative(contact, motions, bias=True), contact.normal)
    relative = _relative(contact, motions)
    speed, slide = dot(relative, contact.normal), dot(relative, perp(contact.normal))

    bias = jnp.maximum(impulses[2] + product(contact.bias - bias_speed, contact.normal_mass), 0)
    normal = jnp.maximum(impulses[0] + product(-(contact.bounce + speed), contact.normal_mass), 0)
    limit = product(jnp.array(FRICTION, normal.dtype), normal)
    tangent = jnp.clip(impulses[1] + product(-slide, contact.tangent_mass), -limit, limit)

    push = contact.normal * (bias - impulses[2])
    impulse = rotate(contact.normal, Vec(normal - impulses[0], tangent - impulses[1]))
    return lanes.stack([normal, tangent, bias]), _apply(world, contact, motions, impulse, push)


def solve(
    topology: Topology,
    world: World,
    timing: Timing,
    contacts: Contacts,
    used: jax.Array,
    links: list[joints.Link],
    motions: list[Motion],
    place: jax.Array,
) -> tuple[Contacts, list[joints.Link], list[Motion]]:
    """Run the sweeps: in each, all contact points in solve order, then the constraints.

    used: number of slots in use in any lane; an empty slot is left as it is because nothing is wanted of it.
    """
    Carry = tuple[jax.Array, list[Motion]]

    def slot(k: jax.Array, fixed: jax.Array, carry: Carry) -> Carry:
        impulses, motions = carry
        contact = unpack_contact(fixed, len(motions))
        new, motions = _solve_point(world, contact, lanes.read(impulses, k), motions)
        return lanes.write(impulses, k, new), motions

    def sweep(
        _: jax.Array, carry: tuple[jax.Array, list[joints.Link], list[Motion]]
    ) -> tuple[jax.Array, list[joints.Link], list[Motion]]:
        impulses, links, motions = carry
        impulses, motions = lanes.visit(contacts.fixed, used, slot, (impulses, motions))
        links, motions = joints.sweep(topology, timing, links, motions, place)
        return impulses, links, motions

    impulses, links, motions = jax.lax.fori_loop(0, SWEEPS, sweep, (contacts.impulses, links, motions))
    return replace(contacts, impulses=impulses), links, motions

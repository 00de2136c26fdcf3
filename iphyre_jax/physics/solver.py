"""Contact solver: pre-step, cached impulses and the sweeps over slots, as the reference's arbiters do it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes
from iphyre_jax.physics.collision.contact_table import STATIC_BODY, ContactPoint, ContactTable
from iphyre_jax.physics.constants import FRICTION, MASS, PERSISTENCE, RESTITUTION, SLOP, SWEEPS
from iphyre_jax.physics.contact_rows import (
    Arm,
    Contact,
    ContactLayout,
    apply_impulse,
    layout_of,
    relative_velocity,
    unpack_contact,
)
from iphyre_jax.physics.joints import Constraints
from iphyre_jax.physics.types import Cache, Motion, Motions, Timing, World
from iphyre_jax.physics.vector import Vec, cross, dot, perp, product, where

FEW_SLOTS = 2  # up to so many are written out, without a loop over slots


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contacts:
    """The contact points of a step in solve order, (K,) rows."""

    points: ContactTable
    packed: jax.Array  # (K, columns), see `contact_rows.Contact`
    impulses: jax.Array  # (K, 3) accumulated: normal, tangent, bias, px/s
    continuing: jax.Array  # (K,) bool, touched in the step before
    num_active: jax.Array  # () int32, slots in use in any lane; an empty slot among them pushes nothing


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CachedImpulses:
    """What the cache holds of a contact point, as far as it was searched."""

    found: jax.Array  # bool, its pair touched in a step searched
    continuing: jax.Array  # bool, in the last step
    normal: jax.Array  # impulses, px/s
    tangent: jax.Array


def read_cache(cache: Cache, point: jax.Array) -> CachedImpulses:
    """Return the impulses of a contact point from the last three steps.

    The newest step in which its pair touched counts, even if this very point is not in it. Of several points with one
    id the last wins. Impulses two or three steps old are starting values, but not applied (`continuing` is False).
    """
    no, zero = jnp.zeros_like(point, bool), jnp.zeros_like(cache.normal_impulse[0, 0])
    first = _match_cached(cache, point, 0, CachedImpulses(no, no, zero, zero))
    first = replace(first, continuing=first.found)

    def older(so_far: CachedImpulses) -> CachedImpulses:
        for age in range(1, PERSISTENCE):
            so_far = _match_cached(cache, point, age, so_far)
        return so_far

    unknown = lanes.any_set(lanes.any_lane((~first.found & (point >= 0))[None]))
    return jax.lax.cond(unknown, older, lambda so_far: so_far, first)


def _match_cached(cache: Cache, point: jax.Array, age: int, so_far: CachedImpulses) -> CachedImpulses:
    """Search one step for a contact point, unless its pair is found already."""
    same_pair, normal, tangent = jnp.zeros_like(so_far.found), so_far.normal, so_far.tangent
    for k in range(cache.point.shape[1]):
        stored = cache.point[age, k]
        match = (stored == point) & ~so_far.found
        same_pair = same_pair | ((stored >> 2) == (point >> 2))
        normal = jnp.where(match, cache.normal_impulse[age, k], normal)
        tangent = jnp.where(match, cache.tangent_impulse[age, k], tangent)
    return replace(so_far, found=so_far.found | same_pair, normal=normal, tangent=tangent)


def write_cache(cache: Cache, contacts: Contacts) -> Cache:
    """Return the cache with this step's points in front and the oldest step dropped."""
    ids = contacts.points.unpack(axis=1).id
    newest = Cache(ids, contacts.impulses[:, 0], contacts.impulses[:, 1])
    return jax.tree.map(lambda new, old: jnp.concatenate([new[None], old[:-1]]), newest, cache)


def unstack(motion: Motion, moving: int) -> Motions:
    """Return the bodies' motions as a list."""
    return [jax.tree.map(lambda leaf, i=i: leaf[i], motion) for i in range(moving)]


def stack(motions: Motions) -> Motion:
    """Return a list of motions as rows."""
    return jax.tree.map(lambda *rows: jnp.stack(rows), *motions)


def prestep(
    world: World, timing: Timing, points: ContactTable, num_active: jax.Array, motions: Motions, cache: Cache
) -> Contacts:
    """Return the contacts of a step: masses, wanted speeds and cached impulses, from the velocities as they are."""
    layout, like = layout_of(world), points.numbers[:, 0]
    lane = like.shape[1:]
    packed = jnp.zeros((like.shape[0], layout.width, *lane), like.dtype)
    impulses = jnp.zeros((like.shape[0], 3, *lane), like.dtype)
    Rows = tuple[ContactTable, jax.Array, jax.Array, jax.Array]

    def prepare(k: jax.Array, row: ContactTable, rows: Rows) -> Rows:
        point = row.unpack()
        known = read_cache(cache, point.id)
        impulses = lanes.stack([known.normal, known.tangent, jnp.zeros_like(known.normal)])
        return lanes.write(rows, k, (row, _prepare(world, timing, point, motions).pack(), impulses, known.continuing))

    rows = lanes.visit(points, num_active, prepare, (points, packed, impulses, jnp.zeros_like(like, bool)))
    return Contacts(*rows, num_active)


def _prepare(world: World, timing: Timing, point: ContactPoint, motions: Motions) -> Contact:
    """Return a contact point's masses and wanted speeds.

    normal mass 1 / sum(1/m + (r x n)^2 / I), tangent mass the same with the tangent; bias speed
    -bias min(0, separation + slop) / dt; bounce = restitution * relative normal speed, never limited.
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
    bias = product(-timing.bias, jnp.minimum(point.separation + SLOP, 0)) / timing.dt
    contact = Contact(point.normal, masses[0], masses[1], bias, bias, *_arms(world, point, layout_of(world)))
    approach = relative_velocity(contact, motions).x
    return replace(contact, bounce=product(approach, jnp.array(RESTITUTION, approach.dtype)))


def _arms(world: World, point: ContactPoint, layout: ContactLayout) -> tuple[tuple[jax.Array, ...], tuple[Arm, ...]]:
    """Return the signs and the signed arms of the bodies."""
    signs, arms, zero = [], [], jnp.zeros_like(point.separation)
    for body, has_tangent_arm in enumerate(layout.has_tangent_arm):
        first, second = point.first == body, point.second == body
        if layout.signs:
            signs.append(jnp.where(second, 1, jnp.where(first, -1, zero)))
        if has_tangent_arm:
            arm = where(second, point.arm_second, where(first, -point.arm_first, Vec(zero, zero)))
            if not layout.exact:
                arm = Vec(dot(arm, point.normal), dot(arm, perp(point.normal)))
            arms.append(Arm(arm.x, arm.y))
        else:  # a ball's arm is as long as its radius; signed, it points against the normal for either body
            arms.append(Arm(jnp.where(first | second, -world.radius[body - layout.bars], zero), None))
    return tuple(signs), tuple(arms)


def apply_cached(world: World, contacts: Contacts, motions: Motions) -> Motions:
    """Give the bodies the impulses of contacts that continue from the step before, in solve order."""
    layout = layout_of(world)

    def apply(_: jax.Array, row: tuple[jax.Array, jax.Array, jax.Array], motions: Motions) -> Motions:
        packed, impulses, continuing = row
        contact, zero = unpack_contact(packed, layout), jnp.zeros_like(impulses[0])
        impulse = where(continuing, Vec(impulses[0], impulses[1]), Vec(zero, zero))
        return apply_impulse(world, contact, motions, impulse)

    return lanes.visit((contacts.packed, contacts.impulses, contacts.continuing), contacts.num_active, apply, motions)


def _larger(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the larger number as the reference does, which takes b for a NaN; one instruction."""
    return jnp.where(a > b, a, b)


def _smaller(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.where(a < b, a, b)


Impulses = tuple[jax.Array, jax.Array, jax.Array]  # normal, tangent, bias


def _solve_point(world: World, contact: Contact, impulses: Impulses, motions: Motions) -> tuple[Impulses, Motions]:
    """Solve one contact point: all three impulses from velocities read before any of them is applied."""
    zero = jnp.zeros_like(impulses[0])
    bias_speed = relative_velocity(contact, motions, bias=True).x
    speed = relative_velocity(contact, motions)

    bias = _larger(impulses[2] + product(contact.bias - bias_speed, contact.normal_mass), zero)
    normal = _larger(impulses[0] + product(-(contact.bounce + speed.x), contact.normal_mass), zero)
    limit = product(jnp.array(FRICTION, normal.dtype), normal)
    tangent = _smaller(_larger(impulses[1] + product(-speed.y, contact.tangent_mass), -limit), limit)

    impulse = Vec(normal - impulses[0], tangent - impulses[1])
    return (normal, tangent, bias), apply_impulse(world, contact, motions, impulse, bias - impulses[2])


def solve(
    world: World,
    contacts: Contacts,
    constraints: Constraints,
    motions: Motions,
    sweep_constraints: Callable[[Constraints, Motions], tuple[Constraints, Motions]],
) -> tuple[Contacts, Constraints, Motions]:
    """Run the sweeps: in each, all contact points in solve order, then the constraints."""
    layout, slots = layout_of(world), contacts.packed.shape[0]

    def slot(k: jax.Array, packed: jax.Array, carry: tuple[jax.Array, Motions]) -> tuple[jax.Array, Motions]:
        impulses, motions = carry
        own = lanes.read(impulses, k)

        def solved() -> tuple[Impulses, Motions]:
            # Taken apart in here: a field that is given to a call is copied before it.
            return _solve_point(world, unpack_contact(packed, layout), (own[0], own[1], own[2]), motions)

        new, motions = lanes.materialize(solved)
        return lanes.write(impulses, k, lanes.stack(new)), motions

    Swept = tuple[jax.Array, Constraints, Motions]

    def sweep(_: jax.Array, swept: Swept) -> Swept:
        impulses, constraints, motions = swept
        impulses, motions = lanes.visit(contacts.packed, contacts.num_active, slot, (impulses, motions))
        return impulses, *sweep_constraints(constraints, motions)

    def written_out(impulses: jax.Array, motions: Motions) -> tuple[jax.Array, Motions]:
        """Run all sweeps over all slots, each kept in values of its own, so that no table is read or written."""
        points = [unpack_contact(contacts.packed[k], layout) for k in range(slots)]

        def sweep(_: jax.Array, carry: tuple[list[Impulses], Motions]) -> tuple[list[Impulses], Motions]:
            (*own,), motions = carry
            for k, contact in enumerate(points):
                own[k], motions = _solve_point(world, contact, own[k], motions)
            return own, motions

        start = [(row[0], row[1], row[2]) for row in impulses]
        own, motions = jax.lax.fori_loop(0, SWEEPS, sweep, (start, motions))
        return jnp.stack([lanes.stack(row) for row in own]), motions

    if slots <= FEW_SLOTS and not constraints:
        # The same code for any number of active slots: float32 would round differently from one form to another.
        impulses, motions = jax.lax.cond(
            contacts.num_active > 0, written_out, lambda *unchanged: unchanged, contacts.impulses, motions
        )
    else:
        impulses, constraints, motions = jax.lax.fori_loop(0, SWEEPS, sweep, (contacts.impulses, constraints, motions))
    return replace(contacts, impulses=impulses), constraints, motions

"""Contact solver: pre-step, cached impulses and the sweeps over slots, as the reference's arbiters do it.

Bodies are lists of rows here, one a moving body, so that a slot's two bodies are picked and put back by selects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.physics import joints, lanes
from iphyre_jax.physics.constants import FRICTION, MASS, PERSISTENCE, RESTITUTION, SLOP, SWEEPS
from iphyre_jax.physics.contacts import Points
from iphyre_jax.physics.types import STATIC, Cache, Motion, Timing, Topology, World
from iphyre_jax.physics.vector import Vec, cross, dot, perp, product, rotate


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contacts:
    """The contact points of a step in solve order, (K,) rows."""

    points: Points
    inv_moment_first: jax.Array
    inv_moment_second: jax.Array  # 0 for a static body
    normal_mass: jax.Array
    tangent_mass: jax.Array
    bias: jax.Array  # px/s, wanted speed of separation along the normal
    bounce: jax.Array  # px/s
    continuing: jax.Array  # bool, touched in the step before
    normal_impulse: jax.Array  # accumulated, px/s
    tangent_impulse: jax.Array
    bias_impulse: jax.Array


def recall(cache: Cache, points: Points, used: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (continuing, normal impulse, tangent impulse) of each slot from the last three steps.

    The newest step in which the pair touched counts, even if this very point is not in it; the last equal point wins.
    Impulses that are two or three steps old are taken over but not applied (`continuing` is False).
    """

    def look(slot: jax.Array, carry: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        point = lanes.row(points.id, slot)
        found, continuing = jnp.zeros_like(point, bool), jnp.zeros_like(point, bool)
        normal, tangent = (jnp.zeros_like(lanes.row(a[0], slot)) for a in (cache.normal_impulse, cache.tangent_impulse))
        for age in range(PERSISTENCE):
            same_pair, same, values = _find(cache, age, point)
            here = same_pair & ~found
            continuing = here if age == 0 else continuing
            normal = jnp.where(here & same, values[0], normal)
            tangent = jnp.where(here & same, values[1], tangent)
            found = found | same_pair
        return lanes.set_row(carry, slot, (continuing, normal, tangent))

    zero = jnp.zeros_like(cache.normal_impulse[0])
    return jax.lax.fori_loop(0, used, look, (jnp.zeros_like(points.id, bool), zero, zero))


def _find(cache: Cache, age: int, point: jax.Array) -> tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array]]:
    """Look a point up in one step of the cache: (its pair is there, the point is there, its impulses)."""
    same_pair, same = jnp.zeros_like(point, bool), jnp.zeros_like(point, bool)
    normal = tangent = jnp.zeros_like(cache.normal_impulse[0, 0])
    for k in range(cache.point.shape[1]):
        stored = cache.point[age, k]
        match = stored == point
        same_pair = same_pair | ((stored >> 2) == (point >> 2))
        same = same | match
        normal = jnp.where(match, cache.normal_impulse[age, k], normal)
        tangent = jnp.where(match, cache.tangent_impulse[age, k], tangent)
    return same_pair, same, (normal, tangent)


def remember(cache: Cache, contacts: Contacts) -> Cache:
    """Return the cache with this step's points in front and the oldest step dropped."""
    newest = Cache(contacts.points.id, contacts.normal_impulse, contacts.tangent_impulse)
    return jax.tree.map(lambda new, old: jnp.concatenate([jnp.expand_dims(new, 0), old[:-1]]), newest, cache)


def unstack(motion: Motion, moving: int) -> list[Motion]:
    """Return the bodies' motions as a list."""
    return [lanes.row(motion, i) for i in range(moving)]


def stack(motions: list[Motion]) -> Motion:
    """Return a list of motions as rows."""
    return jax.tree.map(lambda *rows: jnp.stack(rows), *motions)


def _pick(motions: list[Motion], body: jax.Array) -> Motion:
    return jax.tree.map(lambda *rows: lanes.pick(list(rows), body), *motions)


def _put(motions: list[Motion], body: jax.Array, motion: Motion) -> list[Motion]:
    return [
        jax.tree.map(lambda new, old, i=i: jnp.where(body == i, new, old), motion, old) for i, old in enumerate(motions)
    ]


def _bodies(motions: list[Motion], point: Points) -> tuple[Motion, Motion | None]:
    """Return the motions of a slot's two bodies; None where no second body ever moves."""
    if len(motions) == 1:
        return motions[0], None
    return _pick(motions, point.first), _pick(motions, point.second)


def _put_bodies(motions: list[Motion], point: Points, first: Motion, second: Motion | None) -> list[Motion]:
    if second is None:
        return [first]
    return _put(_put(motions, point.first, first), point.second, second)


def _relative(first: Motion, second: Motion | None, point: Points) -> Vec:
    """Return the velocity of the second contact point against the first."""
    own = first.velocity + perp(point.arm_first) * first.angular
    return -own if second is None else (second.velocity + perp(point.arm_second) * second.angular) - own


def _relative_bias(first: Motion, second: Motion | None, point: Points) -> Vec:
    own = first.bias_velocity + perp(point.arm_first) * first.bias_angular
    return -own if second is None else (second.bias_velocity + perp(point.arm_second) * second.bias_angular) - own


def _apply(motion: Motion, inv_moment: jax.Array, arm: Vec, impulse: Vec) -> Motion:
    """Give a body an impulse at a contact point; its mass is 1."""
    spin = motion.angular + product(inv_moment, cross(arm, impulse))
    return replace(motion, velocity=motion.velocity + impulse, angular=spin)


def _apply_bias(motion: Motion, inv_moment: jax.Array, arm: Vec, impulse: Vec) -> Motion:
    spin = motion.bias_angular + product(inv_moment, cross(arm, impulse))
    return replace(motion, bias_velocity=motion.bias_velocity + impulse, bias_angular=spin)


def prestep(
    world: World, timing: Timing, points: Points, used: jax.Array, motions: list[Motion], cache: Cache
) -> Contacts:
    """Return the contacts of a step: masses, wanted speeds and recalled impulses, from the velocities as they are.

    normal mass 1 / sum(1/m + (r x n)^2 / I), tangent mass the same with the tangent; bias speed
    -bias min(0, distance + slop) / dt; bounce = restitution * relative normal speed, never limited.
    """
    moment = [world.inv_moment[i] for i in range(len(motions))]

    def prepare(point: Points) -> tuple[jax.Array, ...]:
        inv_first, inv_second = lanes.pick(moment, point.first), lanes.pick(moment, point.second)
        inv_mass_second = jnp.where(point.second == STATIC, 0, jnp.array(1.0 / MASS, inv_first.dtype))
        masses = []
        for axis in (point.normal, perp(point.normal)):
            turn_first, turn_second = cross(point.arm_first, axis), cross(point.arm_second, axis)
            total = 1.0 / MASS + product(product(inv_first, turn_first), turn_first)
            total = total + (inv_mass_second + product(product(inv_second, turn_second), turn_second))
            masses.append(1.0 / total)
        bias = product(-timing.bias, jnp.minimum(point.distance + SLOP, 0)) / timing.dt
        approach = dot(_relative(*_bodies(motions, point), point), point.normal)
        return inv_first, inv_second, *masses, bias, product(approach, jnp.array(RESTITUTION, approach.dtype))

    prepared = jax.vmap(prepare)(points)
    recalled = recall(cache, points, used)
    inv_first, inv_second, normal_mass, tangent_mass, bias, bounce = prepared
    impulses = (*recalled, jnp.zeros_like(points.distance))
    return Contacts(points, inv_first, inv_second, normal_mass, tangent_mass, bias, bounce, *impulses)


def apply_cached(contacts: Contacts, used: jax.Array, motions: list[Motion]) -> list[Motion]:
    """Give the bodies the impulses of contacts that continue from the step before, in solve order."""

    def apply(slot: jax.Array, motions: list[Motion]) -> list[Motion]:
        contact = lanes.row(contacts, slot)
        point = contact.points
        first, second = _bodies(motions, point)
        impulse = rotate(point.normal, Vec(contact.normal_impulse, contact.tangent_impulse))
        impulse = Vec(jnp.where(contact.continuing, impulse.x, 0), jnp.where(contact.continuing, impulse.y, 0))
        first = _apply(first, contact.inv_moment_first, point.arm_first, -impulse)
        if second is not None:
            second = _apply(second, contact.inv_moment_second, point.arm_second, impulse)
        return _put_bodies(motions, point, first, second)

    return jax.lax.fori_loop(0, used, apply, motions)


Accumulated = tuple[jax.Array, jax.Array, jax.Array]  # normal, tangent and bias impulses, (K,) each


def _solve_slot(contact: Contacts, motions: list[Motion]) -> tuple[Accumulated, list[Motion]]:
    """Solve one contact point: all three impulses from velocities read before any of them is applied."""
    point = contact.points
    first, second = _bodies(motions, point)
    bias_speed = dot(_relative_bias(first, second, point), point.normal)
    relative = _relative(first, second, point)
    speed, slide = dot(relative, point.normal), dot(relative, perp(point.normal))

    bias = jnp.maximum(contact.bias_impulse + product(contact.bias - bias_speed, contact.normal_mass), 0)
    normal = jnp.maximum(contact.normal_impulse + product(-(contact.bounce + speed), contact.normal_mass), 0)
    limit = product(jnp.array(FRICTION, normal.dtype), normal)
    tangent = jnp.clip(contact.tangent_impulse + product(-slide, contact.tangent_mass), -limit, limit)

    push = point.normal * (bias - contact.bias_impulse)
    impulse = rotate(point.normal, Vec(normal - contact.normal_impulse, tangent - contact.tangent_impulse))
    first = _apply(
        _apply_bias(first, contact.inv_moment_first, point.arm_first, -push),
        contact.inv_moment_first,
        point.arm_first,
        -impulse,
    )
    if second is not None:
        arm, inv = point.arm_second, contact.inv_moment_second
        second = _apply(_apply_bias(second, inv, arm, push), inv, arm, impulse)
    return (normal, tangent, bias), _put_bodies(motions, point, first, second)


def solve(
    topology: Topology,
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

    def with_impulses(impulses: Accumulated) -> Contacts:
        normal, tangent, bias = impulses
        return replace(contacts, normal_impulse=normal, tangent_impulse=tangent, bias_impulse=bias)

    def slot(k: jax.Array, carry: tuple[Accumulated, list[Motion]]) -> tuple[Accumulated, list[Motion]]:
        impulses, motions = carry
        new, motions = _solve_slot(lanes.row(with_impulses(impulses), k), motions)
        return lanes.set_row(impulses, k, new), motions

    def sweep(
        _: jax.Array, carry: tuple[Accumulated, list[joints.Link], list[Motion]]
    ) -> tuple[Accumulated, list[joints.Link], list[Motion]]:
        impulses, links, motions = carry
        impulses, motions = jax.lax.fori_loop(0, used, slot, (impulses, motions))
        links, motions = joints.sweep(topology, timing, links, motions, place)
        return impulses, links, motions

    start = (contacts.normal_impulse, contacts.tangent_impulse, contacts.bias_impulse)
    impulses, links, motions = jax.lax.fori_loop(0, SWEEPS, sweep, (start, links, motions))
    return with_impulses(impulses), links, motions

"""Pin joints and damped springs, each between the centres of two bodies, so without any torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes
from iphyre_jax.physics.constants import SPRING_REST, SPRING_STIFFNESS
from iphyre_jax.physics.types import STATIC, Motion, State, Timing, Topology, World
from iphyre_jax.physics.vector import Vec, dot, length, product


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Link:
    """One constraint during a step."""

    active: jax.Array  # bool, False once the bar that holds it is eliminated
    normal: Vec  # unit, from the first end to the second
    mass: jax.Array  # 1 / (sum of the ends' inverse masses)
    target: jax.Array  # px/s, wanted relative speed along the normal
    impulse: jax.Array  # accumulated, px/s


def prepare(topology: Topology, world: World, timing: Timing, state: State) -> list[Link]:
    """Return the constraints of a step, pins first, before any impulse.

    A pin wants the speed -bias (distance - length) / dt. A spring's target starts at 0 and its impulse is the force of
    the step, (rest - distance) stiffness dt, which `apply_springs` gives to the bodies.
    """
    links = []
    for k, (i, j) in enumerate(topology.constraints):
        first, second = (_end(world, state, k, body) for body in (i, j))
        delta = second - first
        distance = length(delta)
        normal = delta * (1.0 / jnp.where(distance == 0, jnp.inf, distance))
        gone = jnp.any(_holder(world, k) & ~state.alive, axis=0)
        mass = jnp.full_like(distance, 1.0 if STATIC in (i, j) else 0.5)
        if k < len(topology.pins):
            error = product(-timing.bias, distance - world.pin_length[k])
            links.append(Link(~gone, normal, mass, error / timing.dt, state.pin_impulse[k]))
        else:
            force = (SPRING_REST - distance) * SPRING_STIFFNESS
            links.append(Link(~gone, normal, mass, jnp.zeros_like(distance), product(force, timing.dt)))
    return links


def _holder(world: World, k: int) -> jax.Array:
    """Return which static bar holds constraint `k`, (S,) bool; none where both of its ends move."""
    held = jnp.expand_dims(world.anchor_bar[k], 0)
    return held == lanes.iota(world.valid.shape[0], world.anchor_bar[k])


def _end(world: World, state: State, k: int, body: int) -> Vec:
    return world.anchor[k] if body == STATIC else state.position[body]


def _speed(link: Link, motions: list[Motion], ends: tuple[int, int]) -> jax.Array:
    """Return the relative speed along the normal, px/s; a static end is at rest."""
    i, j = ends
    if i == STATIC:
        return dot(motions[j].velocity, link.normal)
    if j == STATIC:
        return dot(-motions[i].velocity, link.normal)
    return dot(motions[j].velocity - motions[i].velocity, link.normal)


def _push(motions: list[Motion], ends: tuple[int, int], link: Link, impulse: jax.Array) -> list[Motion]:
    """Give an impulse along the normal to both ends, where the constraint is active."""
    given = link.normal * jnp.where(link.active, impulse, 0)
    out = list(motions)
    for body, push in ((ends[0], -given), (ends[1], given)):
        if body != STATIC:
            out[body] = replace(out[body], velocity=out[body].velocity + push)
    return out


def apply_springs(topology: Topology, links: list[Link], motions: list[Motion], place: jax.Array) -> list[Motion]:
    """Give the springs' forces of the step to the bodies; the reference does so before gravity."""
    for k, here in _in_order(len(links), place):
        if k >= len(topology.pins):
            motions = _push(motions, topology.constraints[k], _masked(links[k], here), links[k].impulse)
    return motions


def apply_cached(topology: Topology, links: list[Link], motions: list[Motion], place: jax.Array) -> list[Motion]:
    """Give the pins' impulses of the step before to the bodies again."""
    for k, here in _in_order(len(links), place):
        if k < len(topology.pins):
            motions = _push(motions, topology.constraints[k], _masked(links[k], here), links[k].impulse)
    return motions


def sweep(
    topology: Topology, timing: Timing, links: list[Link], motions: list[Motion], place: jax.Array
) -> tuple[list[Link], list[Motion]]:
    """Run one sweep over the constraints in list order.

    Pin: the impulse that gives the wanted speed. Spring: the damping takes its share of the difference to the target
    speed, which becomes the new target; its impulse passes through the accumulator and is rounded there.
    """
    links = list(links)
    for k, here in _in_order(len(links), place):
        ends, link = topology.constraints[k], _masked(links[k], here)
        speed = _speed(link, motions, ends)
        if k < len(topology.pins):
            target, impulse = link.target, product(link.target - speed, link.mass)
        else:
            damped = product(link.target - speed, timing.spring_decay[0 if STATIC in ends else 1])
            target, impulse = speed + damped, product(damped, link.mass)
        total = link.impulse + impulse
        motions = _push(motions, ends, link, total - link.impulse)
        kept = [jnp.where(link.active, new, old) for new, old in ((target, link.target), (total, link.impulse))]
        links[k] = Link(links[k].active, link.normal, link.mass, *kept)
    return links, motions


def _masked(link: Link, here: jax.Array | None) -> Link:
    if here is None:
        return link
    return replace(link, active=link.active & here)


def _in_order(count: int, place: jax.Array) -> list[tuple[int, jax.Array | None]]:
    """List the constraints in solve order, each with the mask of the worlds in which it has that place (None: all).

    Two constraints keep their order when one goes. From three on, the last takes the hole of a removed one.
    """
    if count < 3:
        return [(k, None) for k in range(count)]
    return [(k, place[k] == position) for position in range(count) for k in range(count)]


def close_holes(topology: Topology, world: World, state: State, alive: jax.Array) -> jax.Array:
    """Return the constraints' places after the bars not in `alive` went: the last takes the place of a removed one.

    Bars that go before one step go in the order of their plan columns, and their constraints with them.
    """
    count = len(topology.constraints)
    if count < 3:
        return state.place
    holders = [_holder(world, k) for k in range(count)]
    going = jnp.stack([jnp.any(holder & state.alive & ~alive, axis=0) for holder in holders])
    column = jnp.stack([jnp.max(jnp.where(holder, world.plan_slot, -1), axis=0) for holder in holders])
    turn = column * count + lanes.iota(count, column[0])

    def take_first(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        place, going = carry
        first = jnp.min(jnp.where(going, turn, jnp.iinfo(jnp.int32).max), axis=0, keepdims=True)
        goes = going & (turn == first)
        hole = jnp.max(jnp.where(goes, place, -1), axis=0, keepdims=True)
        last = jnp.max(place, axis=0, keepdims=True)
        filled = jnp.where((place == last) & (hole >= 0), hole, place)
        return jnp.where(goes, -1, filled), going & ~goes

    # A loop, not `count` rounds written out: the compiler repeats nested selections until it takes minutes.
    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), take_first, (state.place, going))[0]

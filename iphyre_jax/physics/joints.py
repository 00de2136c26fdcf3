"""Pin joints and damped springs, each between the centres of two bodies, so without any torque."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes
from iphyre_jax.physics.constants import SPRING_REST, SPRING_STIFFNESS
from iphyre_jax.physics.types import ABSENT, STATIC, Motions, State, Timing, Topology, World
from iphyre_jax.physics.vector import Vec, dot, length, product

Carry = TypeVar("Carry")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Constraint:
    """One constraint during a step."""

    active: jax.Array  # bool, False once the bar that holds it is eliminated
    normal: Vec  # unit, from the first end to the second
    target: jax.Array  # px/s, wanted relative speed along the normal
    impulse: jax.Array  # accumulated, px/s


Constraints = list[Constraint]  # pins, then springs


class SolveOrder(NamedTuple):
    """The order in which the constraints of a step are solved.

    Two constraints keep their order when one goes, and have no ranks. From three on, the last takes the rank of a
    removed one.
    """

    rank: jax.Array  # see `State.constraint_rank`
    num_ranks: jax.Array  # () int32, in use in any lane


def solve_order(rank: jax.Array) -> SolveOrder:
    """Return the order of a step's constraints; rank: see `State.constraint_rank`."""
    return SolveOrder(rank, jnp.max(rank) + 1 if rank.shape[0] else jnp.int32(0))


def prepare(topology: Topology, world: World, timing: Timing, state: State) -> Constraints:
    """Return the constraints of a step, pins first, before any impulse.

    A pin's target is the speed -bias (distance - length) / dt. A spring's target starts at 0. Its impulse is the
    spring force times dt, (rest - distance) stiffness dt, which `apply_springs` gives to the bodies.
    """
    constraints = []
    for k, (i, j) in enumerate(topology.constraint_ends):
        first, second = (_end(world, state, k, body) for body in (i, j))
        delta = second - first
        distance = length(delta)
        normal = delta * (1.0 / jnp.where(distance == 0, jnp.inf, distance))
        gone = jnp.any(_holder(world, k) & ~state.alive, axis=0) | (world.anchor_static[k] == ABSENT)
        if k < len(topology.pins):
            error = product(-timing.bias, distance - world.pin_length[k])
            constraints.append(Constraint(~gone, normal, error / timing.dt, state.pin_impulse[k]))
        else:
            force = (SPRING_REST - distance) * SPRING_STIFFNESS
            constraints.append(Constraint(~gone, normal, jnp.zeros_like(distance), product(force, timing.dt)))
    return constraints


def initial_rank(topology: Topology, world: World) -> jax.Array:
    """Return the constraints' ranks in the solve order before any removal; (0,) with fewer than three."""
    if len(topology.constraint_ends) < 3:
        return jnp.zeros((0, *world.anchor_static.shape[1:]), jnp.int32)
    present = world.anchor_static != ABSENT
    return jnp.where(present, jnp.cumsum(present, axis=0, dtype=jnp.int32) - 1, -1)


def _holder(world: World, k: int) -> jax.Array:
    """Return which static bar holds constraint `k`, (S,) bool; none where both of its ends move."""
    held = jnp.expand_dims(world.anchor_static[k], 0)
    return held == lanes.iota(world.valid.shape[0], world.anchor_static[k])


def _end(world: World, state: State, k: int, body: int) -> Vec:
    return world.anchor[k] if body == STATIC else state.position[body]


def _speed(constraint: Constraint, motions: Motions, ends: tuple[int, int]) -> jax.Array:
    """Return the relative speed along the normal, px/s; a static end is at rest."""
    i, j = ends
    if i == STATIC:
        return dot(motions[j].velocity, constraint.normal)
    if j == STATIC:
        return dot(-motions[i].velocity, constraint.normal)
    return dot(motions[j].velocity - motions[i].velocity, constraint.normal)


def _push(motions: Motions, ends: tuple[int, int], constraint: Constraint, impulse: jax.Array) -> Motions:
    """Give an impulse along the normal to both ends, where the constraint is active."""
    given = constraint.normal * jnp.where(constraint.active, impulse, 0)
    out = list(motions)
    for body, push in ((ends[0], -given), (ends[1], given)):
        if body != STATIC:
            out[body] = replace(out[body], velocity=out[body].velocity + push)
    return out


def apply_springs(topology: Topology, constraints: Constraints, motions: Motions, order: SolveOrder) -> Motions:
    """Give the springs' forces of the step to the bodies; the reference does so before gravity."""
    return _apply(topology, range(len(topology.pins), len(constraints)), constraints, motions, order)


def apply_cached(topology: Topology, constraints: Constraints, motions: Motions, order: SolveOrder) -> Motions:
    """Give the pins' impulses of the step before to the bodies again."""
    return _apply(topology, range(len(topology.pins)), constraints, motions, order)


def _apply(topology: Topology, chosen: range, constraints: Constraints, motions: Motions, order: SolveOrder) -> Motions:
    """Give the accumulated impulses of the chosen constraints to the bodies, in solve order."""
    if not chosen:
        return motions

    def push(k: int, here: jax.Array | None, motions: Motions) -> Motions:
        if k not in chosen:
            return motions
        constraint = _masked(constraints[k], here)
        return _push(motions, topology.constraint_ends[k], constraint, constraint.impulse)

    return _in_order(len(constraints), order, push, motions)


def sweep(
    topology: Topology, timing: Timing, constraints: Constraints, motions: Motions, order: SolveOrder
) -> tuple[Constraints, Motions]:
    """Run one sweep over the constraints in list order."""
    Swept = tuple[Constraints, Motions]

    def solve(k: int, here: jax.Array | None, swept: Swept) -> Swept:
        (*constraints,), motions = swept
        is_pin, ends = k < len(topology.pins), topology.constraint_ends[k]

        def solved() -> tuple[tuple[jax.Array, jax.Array], Motions]:
            return _solve(timing, ends, is_pin, _masked(constraints[k], here), motions)

        (target, impulse), motions = lanes.materialize(solved)
        constraints[k] = replace(constraints[k], target=target, impulse=impulse)
        return constraints, motions

    return _in_order(len(constraints), order, solve, (constraints, motions))


def _solve(
    timing: Timing, ends: tuple[int, int], is_pin: bool, constraint: Constraint, motions: Motions
) -> tuple[tuple[jax.Array, jax.Array], Motions]:
    """Return a constraint's target and impulse after it was solved, and the motions.

    Pin: the impulse that gives the target speed. Spring: damping takes its share of the difference to the target speed;
    the damped speed is the new target. A spring's impulse passes through the accumulator, where it is rounded.
    """
    speed = _speed(constraint, motions, ends)
    mass = jnp.array(1.0 if STATIC in ends else 0.5, speed.dtype)  # 1 / (sum of the ends' inverse masses)
    if is_pin:
        target, impulse = constraint.target, product(constraint.target - speed, mass)
    else:
        damped = product(constraint.target - speed, timing.spring_decay[0 if STATIC in ends else 1])
        target, impulse = speed + damped, product(damped, mass)
    total = constraint.impulse + impulse
    motions = _push(motions, ends, constraint, total - constraint.impulse)
    new = ((target, constraint.target), (total, constraint.impulse))
    target, total = (jnp.where(constraint.active, *pair) for pair in new)
    return (target, total), motions


def _masked(constraint: Constraint, here: jax.Array | None) -> Constraint:
    if here is None:
        return constraint
    return replace(constraint, active=constraint.active & here)


def _in_order(
    count: int, order: SolveOrder, visit: Callable[[int, jax.Array | None, Carry], Carry], carry: Carry
) -> Carry:
    """Return `carry` after a visit of each constraint k, in solve order, with the mask of its worlds (None: all)."""

    def visit_all(rank: jax.Array | None, carry: Carry) -> Carry:
        for k in range(count):
            carry = visit(k, None if rank is None else order.rank[k] == rank, carry)
        return carry

    if order.rank.shape[0] == 0:  # written out: a loop would cost up to a sixth of a step
        return visit_all(None, carry)
    return jax.lax.fori_loop(0, order.num_ranks, visit_all, carry)


def close_holes(topology: Topology, world: World, state: State, alive: jax.Array) -> jax.Array:
    """Return the constraints' ranks without the bars not in `alive`: the last takes the rank of a removed one.

    Bars removed before the same step go in the order of their plan columns, and their constraints with them.
    """
    count = len(topology.constraint_ends)
    if count < 3:
        return state.constraint_rank
    holders = [_holder(world, k) for k in range(count)]
    going = jnp.stack([jnp.any(holder & state.alive & ~alive, axis=0) for holder in holders])
    column = jnp.stack([jnp.max(jnp.where(holder, world.plan_slot, -1), axis=0) for holder in holders])
    turn = column * count + lanes.iota(count, column[0])

    def take_first(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rank, going = carry
        first = jnp.min(jnp.where(going, turn, jnp.iinfo(jnp.int32).max), axis=0, keepdims=True)
        goes = going & (turn == first)
        hole = jnp.max(jnp.where(goes, rank, -1), axis=0, keepdims=True)
        last = jnp.max(rank, axis=0, keepdims=True)
        filled = jnp.where((rank == last) & (hole >= 0), hole, rank)
        return jnp.where(goes, -1, filled), going & ~goes

    # A loop, not `count` rounds written out: the compiler repeats nested selections until it takes minutes.
    return jax.lax.while_loop(lambda carry: jnp.any(carry[1]), take_first, (state.constraint_rank, going))[0]

"""One step of the reference's solver, stage for stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.checks import show
from iphyre_jax.physics import joints, lanes, solver
from iphyre_jax.physics.collision import broad_phase, contacts, shapes
from iphyre_jax.physics.types import (
    Box,
    BroadPhase,
    Cache,
    Motion,
    Motions,
    State,
    Timing,
    Topology,
    World,
    check_parts,
)
from iphyre_jax.physics.vector import Vec, product


def initial_state(topology: Topology, world: World) -> State:
    """Return a world before its first step: everything rests where the scene puts it.

    Raises:
        ValueError: the world is of another topology, or of no class of ours; one line.
    """
    check_parts(topology=topology, world=world)
    start = world.start
    zero = jnp.zeros_like(start.x)
    at_rest = Vec(zero, zero)
    whole = jnp.zeros_like(world.leaf_order)
    lane = start.x.shape[1:]
    motion = Motion(at_rest, zero, at_rest, zero)
    slots = (3, topology.slots, *lane)
    impulses = jnp.zeros(slots, zero.dtype)
    blank = BroadPhase(
        Box(zero, zero, zero, zero),
        jnp.asarray(world.start_path),
        jnp.asarray(world.start_depth),
        whole - 1,
        jnp.asarray(world.pair_counter),
        jnp.zeros_like(whole, bool),
    )
    state = State(
        position=jax.tree.map(jnp.asarray, start),
        position_compensation=at_rest[:0] if world.exact else at_rest,
        angle=zero,
        motion=motion,
        alive=jnp.asarray(world.valid),
        broad=blank,
        gjk_start=jnp.zeros((len(topology.bar_pairs) if world.exact else 0, *lane), jnp.int32),
        cache=Cache(jnp.full(slots, -1, jnp.int32), impulses, impulses),
        pin_impulse=jnp.zeros((len(topology.pins), *lane), zero.dtype),
        constraint_rank=joints.initial_rank(topology, world),
        step=jnp.zeros(lane, jnp.int32),
        overflow=jnp.zeros(lane, bool),
    )
    boxes = shapes.moving_boxes(topology, shapes.world_shapes(topology, world, state))
    fat = broad_phase.grow(boxes, at_rest)
    return replace(state, broad=replace(blank, fat=fat))


def eliminate(topology: Topology, world: World, state: State, removed: jax.Array) -> State:
    """Remove static bars, (S,) bool, with their joints and springs. Their cached contacts never match again.

    Raises:
        ValueError: a part is of another class, or `removed` has another shape or type; one line.
    """
    check_parts(topology=topology, world=world, state=state)
    if jnp.shape(removed)[:1] != (topology.num_static,) or jnp.result_type(removed) != jnp.bool_:
        raise ValueError(f"removed: expected {topology.num_static} flags (and lanes behind), got {show(removed)}")
    alive = state.alive & ~removed
    return replace(state, alive=alive, constraint_rank=joints.close_holes(topology, world, state, alive))


def integrate_positions(state: State, timing: Timing) -> State:
    """Move every body by its velocity and bias velocity of the step before; the bias velocity is used up.

    In float32 the rounding error of a position, up to 3e-5 px a step, is carried to the next step (Kahan's sum).
    """
    motion = state.motion
    shift, position_compensation = (motion.velocity + motion.bias_velocity) * timing.dt, state.position_compensation
    if shift.exact:
        position = state.position + shift
    else:
        shift = shift + position_compensation
        position = state.position + shift
        position_compensation = shift - (position - state.position)
    angle = state.angle + product(motion.angular_velocity + motion.bias_angular_velocity, timing.dt)
    zero = jnp.zeros_like(motion.angular_velocity)
    return replace(
        state,
        position=position,
        position_compensation=position_compensation,
        angle=angle,
        motion=replace(motion, bias_velocity=Vec(zero, zero), bias_angular_velocity=zero),
    )


def integrate_velocities(motions: Motions, timing: Timing) -> Motions:
    """Add gravity; damping is 1."""
    return [replace(one, velocity=Vec(one.velocity.x, one.velocity.y + timing.gravity_dt)) for one in motions]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stages:
    """What a step computes on its way and `State` does not keep."""

    contacts: solver.Contacts  # after the last sweep
    num_touching: jax.Array  # () int32, contact points found; may exceed the slots
    constraints: joints.Constraints  # after the last sweep


def step(topology: Topology, world: World, timing: Timing, state: State) -> State:
    """Advance one world, or one world a lane, by timing.dt seconds.

    Raises:
        ValueError: a part is of another class, or the world of another topology; one line.
    """
    check_parts(topology=topology, world=world, timing=timing, state=state)
    return step_with_stages(topology, world, timing, state)[0]


def step_with_stages(topology: Topology, world: World, timing: Timing, state: State) -> tuple[State, Stages]:
    """Make a step and return its stages too; the compiler drops what nobody reads.

    The stages stand in the reference's order: bodies move first, with the velocities of the step before; contact
    masses and bounce see velocities before springs and gravity; cached impulses come after both.
    """
    state = integrate_positions(state, timing)
    shape = lanes.materialize(lambda: shapes.world_shapes(topology, world, state))
    boxes = shapes.moving_boxes(topology, shape)
    broad = broad_phase.update(topology, world, state.broad, boxes, state.motion.velocity, state.step)
    table, num_touching, gjk_start = contacts.collide(topology, world, shape, broad, state.gjk_start)
    num_active = jnp.minimum(jnp.max(num_touching), topology.slots)

    motions = solver.unstack(state.motion, topology.moving)
    contact = solver.prestep(world, timing, table, num_active, motions, state.cache)
    constraints = joints.prepare(topology, world, timing, state)
    order = joints.solve_order(state.constraint_rank)
    motions = joints.apply_springs(topology, constraints, motions, order)
    motions = integrate_velocities(motions, timing)
    motions = solver.apply_cached(world, contact, motions)
    motions = joints.apply_cached(topology, constraints, motions, order)
    sweep = partial(joints.sweep, topology, timing, order=order)
    contact, constraints, motions = solver.solve(world, contact, constraints, motions, sweep)

    pins = [constraint.impulse for constraint in constraints[: len(topology.pins)]]
    after = replace(
        state,
        motion=solver.stack(motions),
        broad=broad,
        gjk_start=gjk_start,
        cache=solver.write_cache(state.cache, contact),
        pin_impulse=jnp.stack(pins) if pins else state.pin_impulse,
        step=state.step + 1,
        overflow=state.overflow | (num_touching > topology.slots),
    )
    return after, Stages(contact, num_touching, constraints)

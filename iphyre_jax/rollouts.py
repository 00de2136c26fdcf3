"""Episodes under a plan: the jittable layer between the solver and everything that plays games.

A rollout plays one world, or many in lanes (trailing axes). It steps until every lane is done, so the longest game
decides what a group of lanes costs.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.checks import check_whole, cut, show
from iphyre_jax.physics import eliminate, initial_state, step
from iphyre_jax.physics.types import State, Timing, Topology, World, check_parts
from iphyre_jax.physics.vector import Vec
from iphyre_jax.rules import GOAL_Y

FAULT_OVERFLOW = 1  # more contact points at once than the topology has slots
FAULT_NOT_FINITE = 2  # a position or velocity is infinite or not a number


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EpisodeResult:
    """The result of an episode so far; steps after its end change nothing. n moving bodies."""

    position: Vec  # (n,) px
    angle: jax.Array  # (n,) rad
    done: jax.Array  # () bool, solved or faulted
    success: jax.Array  # () bool
    steps: jax.Array  # () int32, physics steps made, the solving one included
    eliminations: jax.Array  # () int32, blocks removed by then
    fault: jax.Array  # () int32, 0 or a FAULT_ code


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EpisodeState:
    """An episode under way."""

    state: State
    result: EpisodeResult


def reset_episode(topology: Topology, world: World, done: jax.Array) -> EpisodeState:
    """Return an episode before its first step.

    done: () bool, True for a spare lane, which is never played.
    """
    state = initial_state(topology, world)
    zero = jnp.zeros_like(state.step)
    no = zero != 0
    return EpisodeState(state, EpisodeResult(state.position, state.angle, done | no, no, zero, zero, zero))


def removal_steps(world: World, plan: jax.Array) -> jax.Array:
    """Return the step before which each static bar is removed, (S,) int32, -1 for never; plan: see `run_until`."""
    removal = jnp.full_like(world.plan_slot, -1)
    for slot in range(plan.shape[0]):
        removal = jnp.where(world.plan_slot == slot, jnp.expand_dims(plan[slot], 0), removal)
    return removal


def run_until(
    topology: Topology, world: World, timing: Timing, plan: jax.Array, episode: EpisodeState, stop_step: jax.Array
) -> EpisodeState:
    """Play on until `stop_step` (traced) steps are made or every lane is done; all lanes stand at the same step.

    plan: (slots,) int32, the 0-based step before which each slot's block is removed; -1 means never.
    """
    removal = removal_steps(world, plan)

    def running(carry: tuple[jax.Array, EpisodeState]) -> jax.Array:
        return (carry[0] < stop_step) & ~jnp.all(carry[1].result.done)

    def once(carry: tuple[jax.Array, EpisodeState]) -> tuple[jax.Array, EpisodeState]:
        k, episode = carry
        return k + 1, episode_step(topology, world, timing, episode, removal == k)

    return jax.lax.while_loop(running, once, (jnp.max(episode.state.step), episode))[1]


def episode_step(
    topology: Topology, world: World, timing: Timing, episode: EpisodeState, removed: jax.Array
) -> EpisodeState:
    """Remove static bars, (S,) bool, make one step and keep the score. An episode that is done keeps its result.

    An episode that is done loses its static bars, so that it costs its neighbours nothing.
    """
    old, done = episode.result, episode.result.done
    removed = removed & episode.state.alive
    count = jnp.where(done, 0, jnp.sum(removed, axis=0, dtype=jnp.int32))
    state = eliminate(topology, world, episode.state, removed | jnp.expand_dims(done, 0))
    state = step(topology, world, timing, state)
    solved = jnp.all(state.position.y[topology.bars :] > GOAL_Y, axis=0)
    fault = jnp.where(_finite(state), jnp.where(state.overflow, FAULT_OVERFLOW, 0), FAULT_NOT_FINITE)
    success = solved & (fault == 0)
    new = EpisodeResult(
        position=state.position,
        angle=state.angle,
        done=success | (fault != 0),
        success=success,
        steps=old.steps + 1,
        eliminations=old.eliminations + count,
        fault=fault,
    )
    return EpisodeState(
        state, jax.tree.map(lambda was, now: jnp.where(jnp.broadcast_to(done, now.shape), was, now), old, new)
    )


def _finite(state: State) -> jax.Array:
    """Return whether all positions and velocities are finite; their sum is infinite or NaN if one of them is."""
    motion = state.motion
    total = sum(
        jnp.abs(part)
        for part in (state.position.x, state.position.y, motion.velocity.x, motion.velocity.y, motion.angular_velocity)
    )
    return jnp.all(jnp.isfinite(total), axis=0)


def _checked_plan(topology: Topology, plan: jax.Array, steps: jax.Array | int) -> jax.Array:
    """Return a plan of integers as int32; ValueError in one line for another, or if `steps` is no number of steps.

    JAX would cut numbers of NumPy to 32 bits, which makes others of them. Those too large are never reached.
    """
    if not isinstance(plan, jax.Array | np.ndarray) or not plan.ndim or plan.dtype.kind not in "iu":
        raise ValueError(f"plan: expected integers, a step for each eliminable block, got {show(plan)}")
    if isinstance(steps, jax.Array | np.ndarray) and not steps.ndim and steps.dtype.kind in "iu":
        steps = steps if isinstance(steps, jax.core.Tracer) else int(steps)
    if not isinstance(steps, jax.core.Tracer):
        if not isinstance(steps, int | np.integer):
            raise ValueError(f"steps: expected one whole number, got {show(steps)}")
        check_whole("steps", steps, 0, topology.max_steps)
    if plan.dtype != np.int32 and plan.dtype.itemsize >= np.dtype(np.int32).itemsize:
        plan = cut(plan)
    return jnp.asarray(plan, jnp.int32)


def rollout(topology: Topology, world: World, timing: Timing, plan: jax.Array, steps: jax.Array) -> EpisodeResult:
    """Play whole episodes: `steps` physics steps (traced) or until every lane is done.

    Everything but the topology may be traced: this is what to call inside `jax.jit`.

    Args:
        topology: of the world; static.
        world: as `compile_scene` returns it, possibly with lanes (further worlds) behind every axis.
        timing: as `step_timing` returns it.
        plan: (slots, *lanes) int32, row s belongs to the s-th eliminable block; see `run_until`.
        steps: () int32, from 0 to `topology.max_steps`.

    Raises:
        ValueError: a part is of another class or shape, or `plan` or `steps` are no integers; one line.
    """
    check_parts(topology=topology, world=world, timing=timing)
    plan = _checked_plan(topology, plan, steps)
    never_done = jnp.zeros(world.start.x.shape[1:], bool)
    return run_until(topology, world, timing, plan, reset_episode(topology, world, never_done), steps).result

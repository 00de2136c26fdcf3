"""Worlds of one topology that each play on from their own clock: what a decision of an environment asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, episode_step, reset_episode


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlayRequest:
    """What one world is to play next."""

    game: jax.Array  # () int32, row of the table
    plan: jax.Array  # (slots,) int32, the 0-based step before which a block goes; -1 or a step gone by: it stays
    stop_step: jax.Array  # () int32, play until so many steps are made or the episode is over


@partial(jax.jit, static_argnums=0)
def initial_episode(topology: Topology, world: World) -> EpisodeState:
    """Return the episode of one world of a topology before its first step."""
    return reset_episode(topology, world, jnp.zeros((), bool))


def run_requests(
    topology: Topology, timing: Timing, world: World, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Play worlds of one topology, each from its own clock to its own end; lanes may stand behind every row.

    Unlike `rollouts.run_until`, which plays all lanes from one common step, a lane waits here while others play on.
    """
    removal = jnp.full_like(world.plan_slot, -1)
    for slot in range(request.plan.shape[0]):
        removal = jnp.where(world.plan_slot == slot, jnp.expand_dims(request.plan[slot], 0), removal)

    def waits(episode: EpisodeState) -> jax.Array:
        return episode.result.done | (episode.state.step >= request.stop_step)

    def once(old: EpisodeState) -> EpisodeState:
        waiting = waits(old)
        # A waiting lane is played as one that is over, which costs the others nothing, and then put back.
        marked = replace(old, result=replace(old.result, done=waiting))
        due = removal == jnp.expand_dims(old.state.step, 0)
        new = episode_step(topology, world, timing, marked, due)
        return jax.tree.map(lambda was, now: jnp.where(jnp.broadcast_to(waiting, now.shape), was, now), old, new)

    return jax.lax.while_loop(lambda episode: ~jnp.all(waits(episode)), once, episode)

"""Play worlds of one topology, each from its own step to its own: one decision of an environment."""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, episode_step, removal_steps


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlayRequest:
    """What one world plays next."""

    plan: jax.Array  # (slots,) int32, the 0-based step before which each block goes; it stays at -1 or a past step
    stop_step: jax.Array  # () int32, play until so many steps are made or the episode is done


def run_requests(
    topology: Topology, timing: Timing, world: World, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Play worlds of one topology until all requests are met; lanes may stand behind every axis.

    `rollouts.run_until` plays all lanes from one common step. Here a lane may wait while others play on.
    """
    removal = removal_steps(world, request.plan)

    def waits(episode: EpisodeState) -> jax.Array:
        return episode.result.done | (episode.state.step >= request.stop_step)

    def once(old: EpisodeState) -> EpisodeState:
        waiting = waits(old)
        # A waiting lane steps like one that is done, which costs the others nothing, and is then put back.
        marked = replace(old, result=replace(old.result, done=waiting))
        due = removal == jnp.expand_dims(old.state.step, 0)
        new = episode_step(topology, world, timing, marked, due)
        return jax.tree.map(lambda was, now: jnp.where(jnp.broadcast_to(waiting, now.shape), was, now), old, new)

    return jax.lax.while_loop(lambda episode: ~jnp.all(waits(episode)), once, episode)

"""Play worlds of one topology, each from its own step to its own: one decision of an environment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from iphyre_jax.execution.layout import flag_words, pack_flags, unpack_flags
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, episode_step, removal_steps


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PlayRequest:
    """What one world plays next."""

    plan: jax.Array  # (slots,) int32, the 0-based step before which each block goes; it stays at -1 or a past step
    stop_step: jax.Array  # () int32, play until so many steps are made or the episode is done


RunRequests = Callable[[Topology, Timing, World, PlayRequest, EpisodeState], EpisodeState]  # as `run_requests`


def request_words(slots: int) -> int:
    """Return the number of words of a packed request."""
    return slots + 1 + flag_words(slots)


def pack_request(plan: jax.Array, stop_step: jax.Array, executed: jax.Array) -> jax.Array:
    """Return a request, and the slots that a combined plan has executed then, as (words,) int32; of one world."""
    return jnp.concatenate([plan, jnp.stack([stop_step, *pack_flags(executed)])])


def unpack_request(words: jax.Array, slots: int) -> tuple[PlayRequest, jax.Array]:
    """Return the request, and the executed slots, (slots,) bool, of a packed one; lanes stay behind."""
    return PlayRequest(words[:slots], words[slots]), unpack_flags(words[slots + 1 :], slots)


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
        return _where(waiting, old, new)

    return jax.lax.while_loop(lambda episode: ~jnp.all(waits(episode)), once, episode)


def run_with_few_slots(
    topology: Topology, timing: Timing, world: World, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Do what `run_requests` does, with `topology.few_slots`; worlds that need more are played again, with all.

    A step takes time for each slot. Which of the two plays a world, its neighbours do not decide: in float32 the two
    may round differently.
    """
    few, old = replace(topology, slots=topology.few_slots), episode.state
    if few == topology:
        return run_requests(topology, timing, world, request, episode)
    crowded = jnp.any(old.cache.point[:, few.slots :] >= 0, axis=(0, 1))
    first = replace(request, stop_step=jnp.where(crowded, old.step, request.stop_step))
    played = _with_slots(run_requests(few, timing, world, first, _with_slots(episode, few.slots)), topology.slots)
    again = crowded | (played.state.overflow & ~old.overflow)

    def play_again() -> EpisodeState:
        second = replace(request, stop_step=jnp.where(again, request.stop_step, old.step))
        return _where(again, run_requests(topology, timing, world, second, episode), played)

    return jax.lax.cond(jnp.any(again), play_again, lambda: played)


def _with_slots(episode: EpisodeState, slots: int) -> EpisodeState:
    return replace(episode, state=replace(episode.state, cache=episode.state.cache.with_slots(slots)))


def _where(here: jax.Array, new: EpisodeState, old: EpisodeState) -> EpisodeState:
    """Return in each lane one of two episodes."""
    return jax.tree.map(lambda new, old: jnp.where(jnp.broadcast_to(here, new.shape), new, old), new, old)

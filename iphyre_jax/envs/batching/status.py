"""The part of an episode that does not depend on its topology: step, result, blocks."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.execution.layout import flag_words, pack_flags, pack_numbers, unpack_flags
from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import EpisodeState


class Status(NamedTuple):
    """The status of an episode. Shapes are those of one world; lanes may stand behind every axis."""

    game: jax.Array  # () int32, row of the parameters
    step: jax.Array  # () int32, physics steps made, the solving one included
    success: jax.Array  # () bool
    eliminations: jax.Array  # () int32, blocks removed by then
    fault: jax.Array  # () int32, 0 for a sound world, see `rollouts`
    present: jax.Array  # (slots,) bool, plan slots whose block is present
    executed: jax.Array  # (slots,) bool, plan slots that a combined plan has executed


def status_of(game: jax.Array, world: World, episode: EpisodeState, executed: jax.Array) -> Status:
    """Return the status of an episode."""
    out = episode.result
    present = present_slots(world, episode, executed.shape[0])
    return Status(game, episode.state.step, out.success, out.eliminations, out.fault, present, executed)


def present_slots(world: World, episode: EpisodeState, slots: int) -> jax.Array:
    """Return which plan slots have a block that is still present, (slots,) bool."""
    return unpack_flags(pack_numbers(world.plan_slot, episode.state.alive, slots), slots)


GAME, STEP, SUCCESS, ELIMINATIONS, FAULT, PRESENT = range(6)  # words of a packed status


def status_words(slots: int) -> int:
    """Return the number of words of a packed status."""
    return PRESENT + 2 * flag_words(slots)


def status_rows(status: Status) -> list[jax.Array]:
    """Return a status as words, each () int32, the blocks as bits; lanes stay behind."""
    numbers = [part.astype(jnp.int32) for part in status[:PRESENT]]
    return [*numbers, *pack_flags(status.present), *pack_flags(status.executed)]


def unpack_status(words: jax.Array, slots: int) -> Status:
    """Return the status of (words,) integers, see `status_rows`; lanes stay behind."""
    game, step, success, eliminations, fault = (words[k].astype(jnp.int32) for k in range(PRESENT))
    first = PRESENT + flag_words(slots)
    present, executed = unpack_flags(words[PRESENT:first], slots), unpack_flags(words[first:], slots)
    return Status(game, step, success != 0, eliminations, fault, present, executed)

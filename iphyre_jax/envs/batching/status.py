"""The part of an episode that does not depend on its topology: step, result, blocks."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import EpisodeState


class Status(NamedTuple):
    """The status of an episode. Shapes are those of one world; lanes may stand behind every axis."""

    game: jax.Array  # () int32, row of the parameters
    step: jax.Array  # () int32, the solver's step count
    success: jax.Array  # () bool
    steps: jax.Array  # () int32, physics steps made, the solving one included
    eliminations: jax.Array  # () int32, blocks removed by then
    fault: jax.Array  # () int32, 0 for a sound world, see `rollouts`
    present: jax.Array  # (slots,) bool, plan slots whose block is present
    executed: jax.Array  # (slots,) bool, plan slots that a combined plan has executed


def status_of(game: jax.Array, world: World, episode: EpisodeState, executed: jax.Array) -> Status:
    """Return the status of an episode."""
    out = episode.result
    present = present_slots(world, episode, executed.shape[0])
    return Status(game, episode.state.step, out.success, out.steps, out.eliminations, out.fault, present, executed)


def present_slots(world: World, episode: EpisodeState, slots: int) -> jax.Array:
    """Return which plan slots have a block that is still present, (slots,) bool."""
    here = [jnp.any((world.plan_slot == slot) & episode.state.alive, axis=0) for slot in range(slots)]
    return jnp.stack(here)


GAME, STEP, SUCCESS, FAULT, PRESENT = 0, 1, 2, 5, 6  # words of a packed status


def status_words(slots: int) -> int:
    """Return the number of words of a packed status."""
    return PRESENT + 2 * slots


def status_rows(status: Status) -> list[jax.Array]:
    """Return a status as words, each () int32; lanes stay behind."""
    return [part.astype(jnp.int32) for part in (*status[:6], *status.present, *status.executed)]


def unpack_status(words: jax.Array) -> Status:
    """Return the status of (words,) integers, see `status_rows`; lanes stay behind."""
    slots = (words.shape[0] - PRESENT) // 2
    game, step, success, steps, eliminations, fault = (words[k].astype(jnp.int32) for k in range(PRESENT))
    present, executed = words[PRESENT : PRESENT + slots] != 0, words[PRESENT + slots :] != 0
    return Status(game, step, success != 0, steps, eliminations, fault, present, executed)

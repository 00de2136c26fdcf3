"""Worlds of one topology that each play on from their own clock: what a decision of an environment asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import Progress, begin, play_step


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Stretch:
    """What one world is to play next."""

    game: jax.Array  # () int32, row of the table
    plan: jax.Array  # (slots,) int32, the 0-based step before which a block goes; -1 or a step gone by: it stays
    until: jax.Array  # () int32, play until so many steps are made or the episode is over


@partial(jax.jit, static_argnums=0)
def start(topology: Topology, world: World) -> Progress:
    """Return the episode of one world of a topology before its first step."""
    return begin(topology, world, jnp.zeros((), bool))


def play_lanes(topology: Topology, timing: Timing, world: World, stretch: Stretch, progress: Progress) -> Progress:
    """Play worlds of one topology, each from its own clock to its own end; lanes may stand behind every row.

    Unlike `rollouts.advance`, which plays all lanes from one common step, a lane waits here while others play on.
    """
    removal = jnp.full_like(world.column, -1)
    for slot in range(stretch.plan.shape[0]):
        removal = jnp.where(world.column == slot, jnp.expand_dims(stretch.plan[slot], 0), removal)

    def waits(progress: Progress) -> jax.Array:
        return progress.outcome.over | (progress.state.step >= stretch.until)

    def once(old: Progress) -> Progress:
        waiting = waits(old)
        # A waiting lane is played as one that is over, which costs the others nothing, and then put back.
        marked = replace(old, outcome=replace(old.outcome, over=waiting))
        due = removal == jnp.expand_dims(old.state.step, 0)
        new = play_step(topology, world, timing, marked, due)
        return jax.tree.map(lambda was, now: jnp.where(jnp.broadcast_to(waiting, now.shape), was, now), old, new)

    return jax.lax.while_loop(lambda progress: ~jnp.all(waits(progress)), once, progress)

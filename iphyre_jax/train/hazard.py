"""On the fly, greedily: each removal comes at the median of its time under the policy.

A policy that acts with a small chance at every decision holds doing nothing for the best action each time: its mode
never acts. What it prefers is a time. The chance that it has not acted since its last removal falls from decision to
decision; once at most half of it is left, the likeliest block goes, and the count begins anew. A policy that is sure of
its action acts at once, as its mode does.

To choose a block that has gone, or a slot without one, does nothing, and policies are free to: it counts as doing
nothing. Else a policy that still prefers the block it has just removed would choose it to the end, where its samples go
on to the next one.

Shapes: B observations.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.scenes import MAX_ELIMINABLE

MEDIAN: Final = 0.5  # of the time until the next removal


class Hazard(NamedTuple):
    """What has gone, and what the policy would have done since each episode's last removal."""

    survival: jax.Array  # (B,) float32 chance that it has removed nothing
    gone: jax.Array  # (B, 6) bool, slots without a block, and those whose block it has removed


def no_hazard(blocks: jax.Array) -> Hazard:
    """The state of B episodes before their first decision; their slots (B, 6) bool that have a block."""
    return Hazard(jnp.ones(len(blocks), jnp.float32), ~blocks)


def median_action(hazard: Hazard, log_probabilities: jax.Array) -> tuple[jax.Array, Hazard]:
    """Decide once in every episode.

    Args:
        hazard: since each episode's last removal.
        log_probabilities: (B, 7) of the actions now: no-op, then the slots; -inf is allowed.

    Returns:
        (B,) int32 actions, 0 for no-op, and the hazard after them.
    """
    blocks = jnp.where(hazard.gone, 0.0, jnp.exp(log_probabilities[:, 1:]))
    survival = hazard.survival * (1.0 - blocks.sum(axis=-1))
    acts = survival <= MEDIAN
    choice = blocks.argmax(axis=-1)
    action = jnp.where(acts, choice + 1, 0).astype(jnp.int32)
    goes = acts[:, None] & jax.nn.one_hot(choice, MAX_ELIMINABLE, dtype=bool)
    return action, Hazard(jnp.where(acts, 1.0, survival), hazard.gone | goes)

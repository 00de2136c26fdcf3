"""On the fly, greedily: each removal comes at the median of its time under the policy.

A policy that acts with a small chance at every decision holds doing nothing for the best action each time: its mode
never acts. What it prefers is a time. The chance that it has not acted since its last removal falls from decision to
decision; once at most half of it is left, the block that it has most often chosen by then goes, and the count begins
anew. A policy that is sure of its action acts at once, as its mode does.

Shapes: B observations.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.scenes import MAX_ELIMINABLE

MEDIAN: Final = 0.5  # of the time until the next removal


class Hazard(NamedTuple):
    """What the policy would have done since each episode's last removal."""

    survival: jax.Array  # (B,) float32 chance that it has removed nothing
    removed: jax.Array  # (B, 6) float32 chance that it has removed the block of each slot first


def no_hazard(count: int) -> Hazard:
    """The state of B episodes before their first decision."""
    return Hazard(jnp.ones(count, jnp.float32), jnp.zeros((count, MAX_ELIMINABLE), jnp.float32))


def median_action(hazard: Hazard, log_probabilities: jax.Array) -> tuple[jax.Array, Hazard]:
    """Decide once in every episode.

    Args:
        hazard: since each episode's last removal.
        log_probabilities: (B, 7) of the actions now: no-op, then the slots; -inf is allowed.

    Returns:
        (B,) int32 actions, 0 for no-op, and the hazard after them.
    """
    probabilities = jnp.exp(log_probabilities)
    removed = hazard.removed + hazard.survival[:, None] * probabilities[:, 1:]
    survival = hazard.survival * probabilities[:, 0]
    acts = survival <= MEDIAN
    # A block with no chance now has gone: a policy may still have preferred it earlier.
    choice = jnp.where(probabilities[:, 1:] > 0, removed, -1.0).argmax(axis=-1)
    action = jnp.where(acts, choice + 1, 0).astype(jnp.int32)
    begun = no_hazard(len(action))
    return action, Hazard(jnp.where(acts, begun.survival, survival), jnp.where(acts[:, None], begun.removed, removed))

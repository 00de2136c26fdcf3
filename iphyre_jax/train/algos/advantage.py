"""How much better than expected each decision went.

Shapes: T decisions, S scenes, P episodes of each, B = S x P episodes scene by scene. Rewards and values are in units of
1000 points here, so that a solved game is worth about 1.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import Normalise, PolicyGradient

POINTS = 1000.0  # of reward in one unit


def gae(
    reward: jax.Array, value: jax.Array, done: jax.Array, last_value: jax.Array, discount: float, trace: float
) -> jax.Array:
    """Generalised advantage estimation (Schulman et al. 2016): sums of (discount trace)^k delta_{t+k} up to the end.

    delta_t = reward_t + discount value_{t+1} - value_t, with no value behind the end of an episode.

    Args:
        reward: (T, B).
        value: (T, B) of the observations before the decisions.
        done: (T, B) bool.
        last_value: (B,) of the observation after the last decision.
        discount: what a reward one decision later counts.
        trace: lambda.

    Returns:
        (T, B) advantages; plus the values they are the targets of the value network.
    """
    goes_on = 1.0 - done.astype(reward.dtype)
    following = jnp.concatenate([value[1:], last_value[None]])
    delta = reward + discount * goes_on * following - value

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        now = step[0] + discount * trace * step[1] * later
        return now, now

    _, advantage = jax.lax.scan(backwards, jnp.zeros_like(last_value), (delta, goes_on), reverse=True)
    return advantage


def normalised(advantage: jax.Array, active: jax.Array, scenes: int, how: Normalise, std_floor: float) -> jax.Array:
    """(T, B) advantages less their mean, divided by standard deviation + floor, over what is active.

    Args:
        advantage: (T, B).
        active: (T, B) bool.
        scenes: S.
        how: over the decisions of each scene, over the batch, or not at all.
        std_floor: in the unit of the advantages.
    """
    if how == "none":
        return advantage
    groups = (advantage.shape[0], scenes if how == "scene" else 1, -1)
    grouped, counts = advantage.reshape(groups), active.reshape(groups).astype(advantage.dtype)
    number = jnp.maximum(counts.sum(axis=(0, 2), keepdims=True), 1.0)
    away = grouped - (grouped * counts).sum(axis=(0, 2), keepdims=True) / number
    std = jnp.sqrt((jnp.square(away) * counts).sum(axis=(0, 2), keepdims=True) / number)
    return (away / (std + std_floor)).reshape(advantage.shape)


def advantages(settings: PolicyGradient, trajectory: Trajectory, scenes: int) -> tuple[jax.Array, jax.Array]:
    """(T, B) normalised advantages and (T, B) targets of the value network of a trajectory."""
    # What follows the last decision is the end of every episode: its value is never looked at.
    nothing = jnp.zeros_like(trajectory.value[0])
    raw = gae(trajectory.reward / POINTS, trajectory.value, trajectory.done, nothing, settings.discount, settings.trace)
    floor = settings.std_floor / POINTS
    return normalised(raw, trajectory.active, scenes, settings.normalise, floor), raw + trajectory.value

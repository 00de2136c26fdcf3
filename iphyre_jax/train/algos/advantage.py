"""Advantages: how much better than expected each decision went.

Shapes: T decisions, S scenes, P episodes of each, B = S x P episodes scene by scene. Rewards and values are in units of
1000 points here, so that a solved game is worth about 1.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import AdvantageScope, PolicyGradient

POINTS = 1000.0  # of reward in one unit


def gae(
    reward: jax.Array, value: jax.Array, done: jax.Array, last_value: jax.Array, gamma: float, gae_lambda: float
) -> jax.Array:
    """Generalised advantage estimation (Schulman et al. 2016): sums of (gamma lambda)^k delta_{t+k} up to the end.

    delta_t = reward_t + gamma value_{t+1} - value_t, where the value after the end of an episode is 0.

    Args:
        reward: (T, B).
        value: (T, B) of the observations before the decisions.
        done: (T, B) bool.
        last_value: (B,) of the observation after the last decision.
        gamma: discount of a reward one decision later.
        gae_lambda: lambda.

    Returns:
        (T, B) advantages; plus the values they are the targets of the value network.
    """
    goes_on = 1.0 - done.astype(reward.dtype)
    next_value = jnp.concatenate([value[1:], last_value[None]])
    delta = reward + gamma * goes_on * next_value - value

    def backwards(later: jax.Array, step: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        now = step[0] + gamma * gae_lambda * step[1] * later
        return now, now

    _, advantage = jax.lax.scan(backwards, jnp.zeros_like(last_value), (delta, goes_on), reverse=True)
    return advantage


def normalize(
    advantage: jax.Array, active: jax.Array, num_scenes: int, scope: AdvantageScope, std_floor: float
) -> jax.Array:
    """Subtract the mean of the active advantages and divide by their standard deviation + floor; (T, B).

    Args:
        advantage: (T, B).
        active: (T, B) bool.
        num_scenes: S.
        scope: normalise over the decisions of each scene, over the batch, or not at all.
        std_floor: in the unit of the advantages.
    """
    if scope == "none":
        return advantage
    groups = (advantage.shape[0], num_scenes if scope == "scene" else 1, -1)
    grouped, counts = advantage.reshape(groups), active.reshape(groups).astype(advantage.dtype)
    number = jnp.maximum(counts.sum(axis=(0, 2), keepdims=True), 1.0)
    away = grouped - (grouped * counts).sum(axis=(0, 2), keepdims=True) / number
    std = jnp.sqrt((jnp.square(away) * counts).sum(axis=(0, 2), keepdims=True) / number)
    return (away / (std + std_floor)).reshape(advantage.shape)


def advantages(settings: PolicyGradient, trajectory: Trajectory, num_scenes: int) -> tuple[jax.Array, jax.Array]:
    """(T, B) normalised advantages and (T, B) targets of the value network of a trajectory."""
    reward, value, done = trajectory.reward / POINTS, trajectory.value, trajectory.done
    after_end = jnp.zeros_like(value[0])  # every episode has ended by the last decision
    raw = gae(reward, value, done, after_end, settings.gamma, settings.gae_lambda)
    floor = settings.std_floor / POINTS
    return normalize(raw, trajectory.active, num_scenes, settings.normalize_advantage, floor), raw + value

"""Replay: episodes cut into transitions and kept in a ring.

A transition spans up to n decisions: the observation, the action, the rewards until then, and the next observation with
the discount of its value, 0 after the end of an episode.

The ring is our own: an update adds as many rows as its episodes made decisions, a number that only the run knows.

Shapes: T decisions, B episodes, N transitions, D numbers in an observation.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.train.algos.advantage import POINTS
from iphyre_jax.train.algos.base import active_first
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import OffPolicy
from iphyre_jax.train.settings.run import TrainConfig


class Transition(NamedTuple):
    """N transitions."""

    obs: jax.Array  # (N, D)
    raw_action: jax.Array  # (N, ...)
    reward: jax.Array  # (N,) in units of 1000 points
    discount: jax.Array  # (N,) of the value of next_obs
    next_obs: jax.Array  # (N, D)


class Buffer(NamedTuple):
    """A ring of transitions; each update overwrites the oldest."""

    transitions: Transition  # (capacity, ...)
    position: jax.Array  # () int32, row that the next update writes first
    size: jax.Array  # () int32, rows that hold a transition


def transitions(settings: OffPolicy, trajectory: Trajectory) -> Transition:
    """The T x B transitions of a trajectory, decision by decision; those after the end of an episode mean nothing."""
    length = trajectory.reward.shape[0]
    reward = jnp.zeros_like(trajectory.reward)
    discount = jnp.ones_like(trajectory.reward)
    for k in range(settings.n_step):  # the reward k decisions later, while the episode goes on
        reward = reward + discount * _later(trajectory.reward / POINTS, k)
        discount = discount * settings.gamma * (1.0 - _later(trajectory.done.astype(jnp.float32), k))
    next_obs = trajectory.obs[jnp.minimum(jnp.arange(length) + settings.n_step, length)]
    whole = Transition(trajectory.obs[:-1], trajectory.raw_action, reward, discount, next_obs)
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)


def _later(values: jax.Array, k: int) -> jax.Array:
    """(T, B) values k decisions later, 0 behind the last."""
    return jnp.concatenate([values[k:], jnp.zeros_like(values[:k])])


def empty(config: TrainConfig, settings: OffPolicy, obs: jax.Array, raw_action: jax.Array) -> Buffer:
    """A buffer without transitions, for observations like (1, D) and raw actions like (1, ...)."""
    capacity = settings.capacity(config.decisions_per_update)

    def zeros(like: jax.Array) -> jax.Array:
        return jnp.zeros((capacity, *like.shape[1:]), like.dtype)

    scalar = jnp.zeros(1, jnp.float32)
    no_transitions = Transition(*map(zeros, (obs, raw_action, scalar, scalar, obs)))
    return Buffer(no_transitions, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def add(config: TrainConfig, settings: OffPolicy, buffer: Buffer, trajectory: Trajectory, key: jax.Array) -> Buffer:
    """Add the transitions of an update that come from episodes that went on; if there are too many, a random subset."""
    whole, active = transitions(settings, trajectory), trajectory.active.reshape(-1)
    rows, capacity = settings.rows(config.decisions_per_update), buffer.transitions.reward.shape[0]
    order = active_first(key, active)[:rows]
    count = active[order].sum(dtype=jnp.int32)  # they come first
    place = jnp.arange(rows)
    row = jnp.where(place < count, (buffer.position + place) % capacity, capacity)  # past the end: written nowhere
    kept = jax.tree.map(lambda old, new: old.at[row].set(new[order], mode="drop"), buffer.transitions, whole)
    return Buffer(kept, (buffer.position + count) % capacity, jnp.minimum(buffer.size + count, capacity))

"""Replay: episodes cut into transitions and kept in a ring.

A transition spans up to n decisions: what was seen, what was chosen, what was paid until then, and what is seen next
with the discount that its value bears, 0 behind the end of an episode.

The ring is our own: a round has a fixed number of rows, so a slice written at the ring's place does.

Shapes: T decisions, B episodes, N transitions in a batch, D numbers in an observation.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar, cast

import jax
import jax.numpy as jnp

from iphyre_jax.train.algos.advantage import POINTS
from iphyre_jax.train.collect import DECISIONS, Trajectory
from iphyre_jax.train.settings.agents import OffPolicy
from iphyre_jax.train.settings.run import TrainConfig

Carry = TypeVar("Carry")
Metrics = dict[str, jax.Array]


class Transition(NamedTuple):
    """N transitions."""

    observation: jax.Array  # (N, D)
    choice: jax.Array  # (N, ...)
    reward: jax.Array  # (N,) in units of 1000 points
    discount: jax.Array  # (N,) of what follows
    following: jax.Array  # (N, D) seen next
    weight: jax.Array  # (N,) 1, or 0 for a row that fills up


def settings_of(config: TrainConfig) -> OffPolicy:
    """The settings of a configuration for learning from a buffer."""
    return cast(OffPolicy, config.learner)


def transitions(settings: OffPolicy, trajectory: Trajectory) -> Transition:
    """All transitions of a trajectory, T x B of them, decision by decision."""
    length = trajectory.reward.shape[0]
    reward = jnp.zeros_like(trajectory.reward)
    discount = jnp.ones_like(trajectory.reward)
    for k in range(settings.n_step):  # the reward k decisions later, while the episode goes on
        reward = reward + discount * _later(trajectory.reward / POINTS, k)
        discount = discount * settings.discount * (1.0 - _later(trajectory.done.astype(jnp.float32), k))
    following = trajectory.observation[jnp.minimum(jnp.arange(length) + settings.n_step, length)]
    whole = Transition(
        trajectory.observation[:-1],
        trajectory.choice,
        reward,
        discount,
        following,
        trajectory.active.astype(jnp.float32),
    )
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)


def _later(values: jax.Array, k: int) -> jax.Array:
    """(T, B) values k decisions later, 0 behind the last."""
    return jnp.concatenate([values[k:], jnp.zeros_like(values[:k])])


class Buffer(NamedTuple):
    """A ring of rounds; each round overwrites the oldest."""

    kept: Transition  # (capacity, ...)
    next: jax.Array  # () int32, row of the next round
    filled: jax.Array  # () int32, rows written so far, at most the capacity


def _rows(config: TrainConfig) -> int:
    """Transitions of a round that are kept."""
    decisions = config.episodes_per_update * DECISIONS.get(config.strategy, 1)
    return min(settings_of(config).rows or decisions, decisions)


def empty(config: TrainConfig, observation: jax.Array, choice: jax.Array) -> Buffer:
    """A buffer without transitions, for observations like (1, D) and choices like (1, ...)."""
    rounds = max(1, settings_of(config).replay // _rows(config))

    def zeros(like: jax.Array) -> jax.Array:
        return jnp.zeros((rounds * _rows(config), *like.shape[1:]), like.dtype)

    none = jnp.zeros(1)
    kept = Transition(*map(zeros, (observation, choice, none, none, observation, none)))
    return Buffer(kept, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def added(config: TrainConfig, buffer: Buffer, trajectory: Trajectory, key: jax.Array) -> Buffer:
    """The buffer with a round's transitions; of more than are kept, those that were there come first, by chance."""
    whole, rows = transitions(settings_of(config), trajectory), _rows(config)
    count = whole.weight.shape[0]
    order = jnp.argsort(jax.random.uniform(key, (count,)) + (1.0 - whole.weight))[:rows]
    kept = jax.tree.map(
        lambda old, new: jax.lax.dynamic_update_slice_in_dim(old, new[order], buffer.next, 0), buffer.kept, whole
    )
    capacity = buffer.kept.weight.shape[0]
    return Buffer(kept, (buffer.next + rows) % capacity, jnp.minimum(buffer.filled + rows, capacity))


def learned(
    config: TrainConfig,
    buffer: Buffer,
    trajectory: Trajectory,
    key: jax.Array,
    start: Carry,
    step: Callable[[Carry, jax.Array, Transition], tuple[Carry, Metrics]],
) -> tuple[Buffer, Carry, Metrics]:
    """Keep a round's transitions, then make the round's gradient steps, each on a batch drawn from the buffer.

    Args:
        config: of the run.
        buffer: before the round.
        trajectory: of the round.
        key: random key.
        start: what the steps change.
        step: one gradient step, given a random key of its own.

    Returns:
        The buffer, what the steps made of `start`, and means of what they report; before the buffer holds enough,
        `start` as it was and zeros.
    """
    add_key, key = jax.random.split(key)
    settings, buffer = settings_of(config), added(config, buffer, trajectory, add_key)

    def once(carry: Carry, key: jax.Array) -> tuple[Carry, Metrics]:
        sample_key, step_key = jax.random.split(key)
        drawn = jax.random.randint(sample_key, (settings.batch,), 0, buffer.filled)
        return step(carry, step_key, jax.tree.map(lambda leaf: leaf[drawn], buffer.kept))

    def steps(carry: Carry) -> tuple[Carry, Metrics]:
        return jax.lax.scan(once, carry, jax.random.split(key, settings.steps))

    def nothing(carry: Carry) -> tuple[Carry, Metrics]:
        return carry, jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(steps, carry)[1])

    carry, metrics = jax.lax.cond(buffer.filled >= settings.warmup, steps, nothing, start)
    return buffer, carry, jax.tree.map(jnp.mean, metrics)


def weighted(values: jax.Array, weight: jax.Array) -> jax.Array:
    """() mean over the transitions that were there."""
    return (values * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def towards(target: Carry, learned: Carry, rate: float) -> Carry:
    """Target weights moved a share of the way to the learned ones."""
    return jax.tree.map(lambda old, new: old + rate * (new - old), target, learned)

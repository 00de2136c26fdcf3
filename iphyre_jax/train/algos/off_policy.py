"""What SAC, DDPG and DQN share: an update keeps its transitions, then makes gradient steps on a replay buffer.

Shapes: S scenes, N transitions, D numbers in an observation.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.train.algos import replay
from iphyre_jax.train.algos.base import Algorithm, Metrics, jitted
from iphyre_jax.train.algos.networks import NOTHING
from iphyre_jax.train.algos.replay import Buffer, Transition
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import OffPolicy

S = TypeVar("S", bound=OffPolicy)
Tree = TypeVar("Tree")
TrainState = Any  # what gradient steps change, of the algorithm


class State(NamedTuple):
    """All that an update changes."""

    train_state: TrainState
    buffer: Buffer
    num_updates: Any = NOTHING  # () int32, for schedules


class OffPolicyAlgorithm(Algorithm[S]):
    """Learns from a replay buffer."""

    @abstractmethod
    def gradient_step(
        self, num_updates: jax.Array, train_state: TrainState, key: jax.Array, batch: Transition
    ) -> tuple[TrainState, Metrics]:
        """One gradient step on a batch drawn from the buffer, with a random key of its own."""

    def empty_buffer(self, obs: jax.Array, raw_action: jax.Array) -> Buffer:
        """A buffer for observations like (1, D) and raw actions like (1, ...)."""
        return replay.empty(self.config, self.settings, obs, raw_action)

    @jitted(0, 4)
    def learn(self, state: State, key: jax.Array, trajectory: Trajectory, num_scenes: int) -> tuple[State, Metrics]:
        """See `Algorithm`; metrics are means over the gradient steps, NaN without any."""
        del num_scenes
        add_key, key = jax.random.split(key)
        buffer = replay.add(self.config, self.settings, state.buffer, trajectory, add_key)
        train_state, metrics = self.update_from_buffer(state, buffer, key)
        num_updates = jax.tree.map(lambda number: number + 1, state.num_updates)
        return State(train_state, buffer, num_updates), jax.tree.map(jnp.mean, metrics)

    def update_from_buffer(self, state: State, buffer: Buffer, key: jax.Array) -> tuple[TrainState, Metrics]:
        """Make the gradient steps of an update; none, and NaN as metrics, until the buffer holds `warmup`."""
        settings = self.settings

        def step(carry: TrainState, key: jax.Array) -> tuple[TrainState, Metrics]:
            sample_key, step_key = jax.random.split(key)
            drawn = jax.random.randint(sample_key, (settings.batch_size,), 0, buffer.size)
            batch = jax.tree.map(lambda leaf: leaf[drawn], buffer.transitions)
            return self.gradient_step(state.num_updates, carry, step_key, batch)

        steps = partial(jax.lax.scan, step, xs=jax.random.split(key, settings.gradient_steps))

        def nothing(carry: TrainState) -> tuple[TrainState, Metrics]:
            return carry, jax.tree.map(
                lambda leaf: jnp.full(leaf.shape, jnp.nan, leaf.dtype), jax.eval_shape(steps, carry)[1]
            )

        train_state, metrics = jax.lax.cond(buffer.size >= settings.warmup, steps, nothing, state.train_state)
        return train_state, metrics


def polyak_update(target: Tree, learned: Tree, tau: float) -> Tree:
    """Target weights moved a share of the way to the learned ones."""
    return jax.tree.map(lambda old, new: old + tau * (new - old), target, learned)


def linear_schedule(num_updates: jax.Array, first: float, last: float, duration: int) -> jax.Array:
    """() value that goes linearly from the first to the last over so many updates."""
    share = jnp.minimum(num_updates.astype(jnp.float32) / duration, 1.0)
    return first + share * (last - first)

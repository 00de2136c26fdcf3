"""The random agent: uniform over the actions. All other agents are compared with it."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.train.algos.base import Algorithm, Metrics, jitted, without_value
from iphyre_jax.train.collect import PolicyOutput, Trajectory
from iphyre_jax.train.settings.agents import Random


class State(NamedTuple):
    """All that an update changes."""

    num_updates: jax.Array  # () int32


class RandomAlgorithm(Algorithm[Random]):
    """Learns nothing."""

    @property
    def _plans(self) -> bool:
        """Whether actions are times."""
        return self.config.strategy != "on-the-fly"

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        del key, obs
        return State(jnp.zeros((), jnp.int32))

    @jitted(0, 4)
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """See `Algorithm`."""
        del state
        count = obs.shape[0] * num_samples
        if self._plans:
            action = jax.random.uniform(key, (count, MAX_ELIMINABLE), jnp.float32)
        else:
            action = jax.random.randint(key, (count,), 0, MAX_ELIMINABLE + 1, jnp.int32)
        return without_value(action, action)

    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """Remove nothing, for each observation (B, D): no action is preferred."""
        del state
        if self._plans:
            return jnp.zeros((obs.shape[0], MAX_ELIMINABLE), jnp.float32)
        return jnp.zeros(obs.shape[0], jnp.int32)

    def inference_state(self, state: State) -> State:
        """See `Algorithm`."""
        return state

    def learn(self, state: State, key: jax.Array, trajectory: Trajectory, num_scenes: int) -> tuple[State, Metrics]:
        """Learn nothing."""
        del key, trajectory, num_scenes
        return State(state.num_updates + 1), {}

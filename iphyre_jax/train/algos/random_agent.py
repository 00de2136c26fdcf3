"""The random agent: uniform over the actions, with nothing to learn. The row that all others are compared with."""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.settings.run import PLANNED, TrainConfig

METRICS: Final = ()
Metrics = dict[str, jax.Array]


class State(NamedTuple):
    """All that a round changes."""

    made: jax.Array  # () int32, rounds


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round."""
    del config, key, observation
    return State(jnp.zeros((), jnp.int32))


@partial(jax.jit, static_argnums=(0, 3))
def _decide(config: TrainConfig, key: jax.Array, observation: jax.Array, each: int) -> Decision:
    observation = jnp.repeat(observation, each, axis=0)
    nothing = jnp.zeros(observation.shape[0], jnp.float32)
    if config.strategy in PLANNED:
        action = jax.random.uniform(key, (observation.shape[0], MAX_ELIMINABLE), jnp.float32)
    else:
        action = jax.random.randint(key, (observation.shape[0],), 0, MAX_ELIMINABLE + 1, jnp.int32)
    return Decision(action, action, nothing, nothing)


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """So many random decisions for each observation (B, D)."""
    del state
    return _decide(config, key, observation, each)


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """Nothing, for each observation (B, D): there is no action that it holds for best."""
    del state
    if config.strategy in PLANNED:
        return jnp.zeros((observation.shape[0], MAX_ELIMINABLE), jnp.float32)
    return jnp.zeros(observation.shape[0], jnp.int32)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return state


def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Nothing."""
    del config, key, trajectory, scenes
    return State(state.made + 1), {}

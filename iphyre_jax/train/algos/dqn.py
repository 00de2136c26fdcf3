"""Deep Q-network (Mnih et al. 2015) with double learning and two streams, on the fly.

A network values all seven actions of a moment; the best is taken, but for a share epsilon of random ones, of which most
do nothing: a decision comes every 0.1 s, and blocks that are gone do not come back.

Shapes: N transitions, D numbers in an observation.
"""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.train.algos import replay
from iphyre_jax.train.algos.distributions import CategoricalHead
from iphyre_jax.train.algos.networks import NOTHING, VALUE_SCALE, Params, network
from iphyre_jax.train.algos.replay import Transition, weighted
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import DQN
from iphyre_jax.train.settings.run import TrainConfig

METRICS: Final = ("value_loss", "epsilon")
Metrics = dict[str, jax.Array]


class Learned(NamedTuple):
    """What gradient steps change."""

    value: Params
    target: Params
    optimiser: optax.OptState


class State(NamedTuple):
    """All that a round changes."""

    learned: Learned
    buffer: replay.Buffer
    made: jax.Array  # () int32, rounds


def _settings(config: TrainConfig) -> DQN:
    return cast(DQN, config.learner)


def _network(config: TrainConfig) -> nn.Module:
    return network(config, (MAX_ELIMINABLE + 1,), VALUE_SCALE, dueling=_settings(config).dueling)


def values(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """(N, 7) values of the actions; of slots without a block far below all others."""
    nothing = jnp.ones((*observation.shape[:-1], 1), bool)
    there = jnp.concatenate([nothing, slot_mask(observation)], axis=-1)
    return jnp.where(there, cast(jax.Array, _network(config).apply(params, observation)), -1e3)


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round; observations (S, D) of the training games give sizes and centre."""
    value = _network(config).init(key, observation)
    optimiser = optax.adam(_settings(config).learning_rate)
    learned = Learned(value, jax.tree.map(jnp.copy, value), optimiser.init(value))
    buffer = replay.empty(config, observation, jnp.zeros((1,), jnp.int32))
    return State(learned, buffer, jnp.zeros((), jnp.int32))


def epsilon(config: TrainConfig, made: jax.Array) -> jax.Array:
    """() share of random actions after so many rounds."""
    settings = _settings(config)
    share = jnp.minimum(made.astype(jnp.float32) / settings.epsilon_rounds, 1.0)
    return settings.epsilon + share * (settings.epsilon_end - settings.epsilon)


@partial(jax.jit, static_argnums=(0, 5))
def _decide(
    config: TrainConfig, value: Params, made: jax.Array, key: jax.Array, observation: jax.Array, each: int
) -> Decision:
    observation = jnp.repeat(observation, each, axis=0)
    share_key, random_key = jax.random.split(key)
    mask = slot_mask(observation)
    random = CategoricalHead(_settings(config).idle).sample(random_key, jnp.zeros((*mask.shape[:-1], 7)), mask)
    best = values(config, value, observation).argmax(axis=-1).astype(jnp.int32)
    chance = jax.random.uniform(share_key, best.shape) < epsilon(config, made)
    action = jnp.where(chance, random, best)
    nothing = jnp.zeros(observation.shape[0], jnp.float32)
    return Decision(action, action, nothing, nothing)


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """The best action with a share of random ones, so often for each observation (B, D), one after the other."""
    return _decide(config, state.learned.value, state.made, key, observation, each)


@partial(jax.jit, static_argnums=0)
def _best(config: TrainConfig, value: Params, observation: jax.Array) -> jax.Array:
    return values(config, value, observation).argmax(axis=-1).astype(jnp.int32)


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """The best action for each observation (B, D)."""
    return _best(config, state.learned.value, observation)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return State(Learned(state.learned.value, NOTHING, NOTHING), NOTHING, state.made)


def targets(config: TrainConfig, learned: Learned, batch: Transition) -> jax.Array:
    """(N,) what the values should be: reward + discount Q' of the best of what follows."""
    judged = values(config, learned.target, batch.following)
    chooser = learned.value if _settings(config).double else learned.target
    best = values(config, chooser, batch.following).argmax(axis=-1)
    return batch.reward + batch.discount * jnp.take_along_axis(judged, best[:, None], axis=-1)[:, 0]


def loss(value: Params, config: TrainConfig, batch: Transition, target: jax.Array) -> jax.Array:
    """() squared distance of the values of what was chosen from their targets."""
    given = values(config, value, batch.observation)
    taken = jnp.take_along_axis(given, batch.choice[:, None], axis=-1)[:, 0]
    return weighted(jnp.square(taken - target), batch.weight)


@partial(jax.jit, static_argnums=(0, 4))
def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Keep a round's episodes and make its gradient steps; the new state and what to report."""
    del scenes
    settings, optimiser = _settings(config), optax.adam(_settings(config).learning_rate)

    def step(learned: Learned, key: jax.Array, batch: Transition) -> tuple[Learned, Metrics]:
        del key
        target = jax.lax.stop_gradient(targets(config, learned, batch))
        wrong, gradient = jax.value_and_grad(loss)(learned.value, config, batch, target)
        changes, moments = optimiser.update(gradient, learned.optimiser)
        value: Params = optax.apply_updates(learned.value, changes)
        moved = replay.towards(learned.target, value, settings.target_rate)
        return Learned(value, moved, moments), {"value_loss": wrong, "epsilon": epsilon(config, state.made)}

    buffer, learned, metrics = replay.learned(config, state.buffer, trajectory, key, state.learned, step)
    return State(learned, buffer, state.made + 1), metrics

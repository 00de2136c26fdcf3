"""Deep deterministic policy gradient (Lillicrap et al. 2016), in advance.

A network gives the times, another values them, and the first follows the gradient of the second. Noise is added to the
times while episodes are played.

Shapes: N transitions, D numbers in an observation.
"""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos import replay
from iphyre_jax.train.algos.distributions import PointHead
from iphyre_jax.train.algos.networks import NOTHING, POLICY_SCALE, VALUE_SCALE, Params, network
from iphyre_jax.train.algos.replay import Transition, weighted
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import DDPG
from iphyre_jax.train.settings.run import TrainConfig

METRICS: Final = ("policy_loss", "value_loss", "noise")
Metrics = dict[str, jax.Array]

HEAD: Final = PointHead()


class Learned(NamedTuple):
    """What gradient steps change."""

    policy: Params
    value: Params
    target_policy: Params
    target_value: Params
    policy_optimiser: optax.OptState
    value_optimiser: optax.OptState


class State(NamedTuple):
    """All that a round changes."""

    learned: Learned
    buffer: replay.Buffer
    made: jax.Array  # () int32, rounds


def _settings(config: TrainConfig) -> DDPG:
    return cast(DDPG, config.learner)


def _policy_network(config: TrainConfig) -> nn.Module:
    return network(config, HEAD.shape, POLICY_SCALE)


def _action(config: TrainConfig, policy: Params, observation: jax.Array) -> jax.Array:
    """(N, 6) the policy's times as shares of 15 s."""
    mask = slot_mask(observation)
    outputs = cast(jax.Array, _policy_network(config).apply(policy, observation))
    return HEAD.action(HEAD.mode(outputs, mask))


def _value(config: TrainConfig, value: Params, observation: jax.Array, action: jax.Array) -> jax.Array:
    """(N,) values of times; those of slots without a block do not count."""
    seen = jnp.concatenate([observation, action * slot_mask(observation)], axis=-1)
    return cast(jax.Array, network(config, (), VALUE_SCALE).apply(value, seen))


def _optimisers(config: TrainConfig) -> tuple[optax.GradientTransformation, optax.GradientTransformation]:
    """Of the policy and of the value."""
    return optax.adam(_settings(config).actor_rate), optax.adam(_settings(config).learning_rate)


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round; observations (S, D) of the training games give sizes and centre."""
    policy_key, value_key = jax.random.split(key)
    action = jnp.zeros((len(observation), HEAD.shape[0]), jnp.float32)
    policy = _policy_network(config).init(policy_key, observation)
    value = network(config, (), VALUE_SCALE).init(value_key, jnp.concatenate([observation, action], axis=-1))
    of_policy, of_value = _optimisers(config)
    target_policy, target_value = jax.tree.map(jnp.copy, (policy, value))
    learned = Learned(policy, value, target_policy, target_value, of_policy.init(policy), of_value.init(value))
    return State(learned, replay.empty(config, observation, action), jnp.zeros((), jnp.int32))


def noise(config: TrainConfig, made: jax.Array) -> jax.Array:
    """() standard deviation of the noise after so many rounds."""
    settings = _settings(config)
    share = jnp.minimum(made.astype(jnp.float32) / settings.noise_rounds, 1.0)
    return settings.noise + share * (settings.noise_end - settings.noise)


@partial(jax.jit, static_argnums=(0, 5))
def _decide(
    config: TrainConfig, policy: Params, made: jax.Array, key: jax.Array, observation: jax.Array, each: int
) -> Decision:
    observation = jnp.repeat(observation, each, axis=0)
    noise_key, uniform_key = jax.random.split(key)
    planned = _action(config, policy, observation)
    noisy = jnp.clip(planned + noise(config, made) * jax.random.normal(noise_key, planned.shape), 0.0, 1.0)
    uniform = jax.random.uniform(uniform_key, planned.shape)
    action = jnp.where(made < _settings(config).random_rounds, uniform, noisy)
    nothing = jnp.zeros(observation.shape[0], jnp.float32)
    return Decision(action, action, nothing, nothing)


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """The policy's times with noise, so often for each observation (B, D), one observation after the other."""
    return _decide(config, state.learned.policy, state.made, key, observation, each)


@partial(jax.jit, static_argnums=0)
def _best(config: TrainConfig, policy: Params, observation: jax.Array) -> jax.Array:
    return _action(config, policy, observation)


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """The policy's times for each observation (B, D)."""
    return _best(config, state.learned.policy, observation)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return State(Learned(state.learned.policy, *[NOTHING] * 5), NOTHING, state.made)


def value_loss(value: Params, config: TrainConfig, learned: Learned, batch: Transition) -> jax.Array:
    """() squared distance of the values from reward + discount Q' of what follows."""
    following = _action(config, learned.target_policy, batch.following)
    target = batch.reward + batch.discount * _value(config, learned.target_value, batch.following, following)
    wrong = _value(config, value, batch.observation, batch.choice) - jax.lax.stop_gradient(target)
    return weighted(jnp.square(wrong), batch.weight)


def policy_loss(policy: Params, config: TrainConfig, value: Params, batch: Transition) -> jax.Array:
    """() minus the value of the policy's times."""
    action = _action(config, policy, batch.observation)
    return -weighted(_value(config, value, batch.observation, action), batch.weight)


@partial(jax.jit, static_argnums=(0, 4))
def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Keep a round's episodes and make its gradient steps; the new state and what to report."""
    del scenes
    of_policy, of_value = _optimisers(config)
    rate = _settings(config).target_rate

    def step(learned: Learned, key: jax.Array, batch: Transition) -> tuple[Learned, Metrics]:
        del key
        wrong, gradient = jax.value_and_grad(value_loss)(learned.value, config, learned, batch)
        changes, value_moments = of_value.update(gradient, learned.value_optimiser)
        value: Params = optax.apply_updates(learned.value, changes)
        cost, gradient = jax.value_and_grad(policy_loss)(learned.policy, config, value, batch)
        changes, policy_moments = of_policy.update(gradient, learned.policy_optimiser)
        policy: Params = optax.apply_updates(learned.policy, changes)
        target_policy = replay.towards(learned.target_policy, policy, rate)
        target_value = replay.towards(learned.target_value, value, rate)
        metrics = {"policy_loss": cost, "value_loss": wrong, "noise": noise(config, state.made)}
        return Learned(policy, value, target_policy, target_value, policy_moments, value_moments), metrics

    buffer, learned, metrics = replay.learned(config, state.buffer, trajectory, key, state.learned, step)
    return State(learned, buffer, state.made + 1), metrics

"""Soft actor-critic (Haarnoja et al. 2018; discrete: Christodoulou 2019), for all three strategies.

The policy maximises reward plus alpha times entropy; alpha is learned so that the entropy stays at its target. One form
serves times and the seven actions on the fly: an expectation over the policy's choices, each with a log-probability, a
weight and a value. On the fly the choices are all seven, weighted by their probabilities; times are one sample of
weight 1.

Shapes: N transitions, A choices of each (7 on the fly, else 1), D numbers in an observation.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos import replay
from iphyre_jax.train.algos.distributions import CategoricalHead, action_head
from iphyre_jax.train.algos.networks import NOTHING, POLICY_SCALE, VALUE_SCALE, Params, network
from iphyre_jax.train.algos.replay import Transition, weighted
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import SAC
from iphyre_jax.train.settings.run import TrainConfig

METRICS: Final = ("policy_loss", "value_loss", "entropy", "alpha")
Metrics = dict[str, jax.Array]


class Learned(NamedTuple):
    """What gradient steps change."""

    params: Params  # "policy", "values" (two networks), "log_alpha"
    target: Params  # of the two value networks
    optimiser: optax.OptState


class State(NamedTuple):
    """All that a round changes."""

    learned: Learned
    buffer: replay.Buffer


class Choices(NamedTuple):
    """What a policy may choose, for each of N observations."""

    log_prob: jax.Array  # (N, A)
    weight: jax.Array  # (N, A), sums to 1
    choice: jax.Array  # (N, 6) the sample; (N, 7) the outputs' log-probabilities on the fly, not looked at


def _settings(config: TrainConfig) -> SAC:
    return cast(SAC, config.learner)


def _discrete(config: TrainConfig) -> bool:
    return isinstance(action_head(config.head), CategoricalHead)


def _policy(config: TrainConfig) -> nn.Module:
    return network(config, action_head(config.head).shape, POLICY_SCALE)


def _value(config: TrainConfig) -> nn.Module:
    """From observations to the values of all seven, or from observations with actions to their value."""
    return network(config, action_head(config.head).shape if _discrete(config) else (), VALUE_SCALE)


def _values(config: TrainConfig, both: Params, observation: jax.Array, choice: jax.Array) -> jax.Array:
    """(2, N, A) values by the two networks: of all seven, or of the choice."""
    if _discrete(config):
        return jnp.stack([cast(jax.Array, _value(config).apply(one, observation)) for one in both])
    action = action_head(config.head).action(choice) * slot_mask(observation)
    seen = jnp.concatenate([observation, action], axis=-1)
    return jnp.stack([cast(jax.Array, _value(config).apply(one, seen))[:, None] for one in both])


def _choices(config: TrainConfig, policy: Params, key: jax.Array, observation: jax.Array) -> Choices:
    """What the policy may choose."""
    head, mask = action_head(config.head), slot_mask(observation)
    outputs = cast(jax.Array, _policy(config).apply(policy, observation))
    if isinstance(head, CategoricalHead):
        log_prob = head.log_probabilities(outputs, mask)
        # A choice of probability 0 has no part in any mean; -inf times 0 would be no number.
        return Choices(jnp.maximum(log_prob, -1e3), jnp.exp(log_prob), log_prob)
    choice = head.sample(key, outputs, mask)
    log_prob = head.log_prob(outputs, choice, mask)[:, None]
    return Choices(log_prob, jnp.ones_like(log_prob), choice)


def _optimiser(config: TrainConfig) -> optax.GradientTransformation:
    return optax.adam(_settings(config).learning_rate)


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round; observations (S, D) of the training games give sizes and centre."""
    keys, head = jax.random.split(key, 3), action_head(config.head)
    choice = (
        jnp.zeros((1,), jnp.int32) if _discrete(config) else jnp.zeros((len(observation), head.shape[0]), jnp.float32)
    )
    seen = observation if _discrete(config) else jnp.concatenate([observation, choice], axis=-1)
    values = tuple(_value(config).init(one, seen) for one in keys[1:])
    params = {
        "policy": _policy(config).init(keys[0], observation),
        "values": values,
        "log_alpha": jnp.log(jnp.asarray(_settings(config).alpha, jnp.float32)),
    }
    learned = Learned(params, jax.tree.map(jnp.copy, values), _optimiser(config).init(params))
    return State(learned, replay.empty(config, observation, choice))


@partial(jax.jit, static_argnums=(0, 4))
def _decide(config: TrainConfig, policy: Params, key: jax.Array, observation: jax.Array, each: int) -> Decision:
    observation = jnp.repeat(observation, each, axis=0)
    head, mask = action_head(config.head), slot_mask(observation)
    choice = head.sample(key, cast(jax.Array, _policy(config).apply(policy, observation)), mask)
    nothing = jnp.zeros(observation.shape[0], jnp.float32)
    return Decision(head.action(choice), choice, nothing, nothing)


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """Sample so many decisions for each observation (B, D), one observation after the other."""
    return _decide(config, state.learned.params["policy"], key, observation, each)


@partial(jax.jit, static_argnums=0)
def _best(config: TrainConfig, policy: Params, observation: jax.Array) -> jax.Array:
    head, outputs = action_head(config.head), cast(jax.Array, _policy(config).apply(policy, observation))
    return head.action(head.mode(outputs, slot_mask(observation)))


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """The most probable action for each observation (B, D)."""
    return _best(config, state.learned.params["policy"], observation)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return State(Learned({"policy": state.learned.params["policy"]}, NOTHING, NOTHING), NOTHING)


def targets(config: TrainConfig, learned: Learned, key: jax.Array, batch: Transition) -> jax.Array:
    """(N,) what the values should be: reward + discount E[min Q' - alpha log pi] of what follows."""
    choices = _choices(config, learned.params["policy"], key, batch.following)
    values = _values(config, learned.target, batch.following, choices.choice).min(axis=0)
    alpha = jnp.exp(learned.params["log_alpha"])
    soft = (choices.weight * (values - alpha * choices.log_prob)).sum(axis=-1)
    return batch.reward + batch.discount * soft


def loss(
    params: Params, config: TrainConfig, key: jax.Array, batch: Transition, target: jax.Array
) -> tuple[jax.Array, Metrics]:
    """The sum of three losses that share no weights: of the values, of the policy, of alpha."""
    values = _values(config, params["values"], batch.observation, batch.choice)
    taken = values[..., 0]
    if _discrete(config):
        taken = jnp.take_along_axis(values, batch.choice[None, :, None], axis=-1)[..., 0]
    value_loss = weighted(jnp.square(taken - target[None]).mean(axis=0), batch.weight)
    choices = _choices(config, params["policy"], key, batch.observation)
    fixed = jax.lax.stop_gradient(params["values"])
    judged = _values(config, fixed, batch.observation, choices.choice).min(axis=0)
    alpha = jnp.exp(params["log_alpha"])
    cost = jax.lax.stop_gradient(alpha) * choices.log_prob - judged
    policy_loss = weighted((choices.weight * cost).sum(axis=-1), batch.weight)
    entropy = -(choices.weight * choices.log_prob).sum(axis=-1)
    blocks = jnp.ones_like(entropy) if _discrete(config) else slot_mask(batch.observation).sum(axis=-1)
    surplus = jax.lax.stop_gradient(entropy - blocks * _settings(config).target_entropy)
    alpha_loss = weighted(params["log_alpha"] * surplus, batch.weight)
    metrics = {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": weighted(entropy, batch.weight)}
    return value_loss + policy_loss + alpha_loss, {**metrics, "alpha": alpha}


@partial(jax.jit, static_argnums=(0, 4))
def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Keep a round's episodes and make its gradient steps; the new state and what to report."""
    del scenes

    def step(learned: Learned, key: jax.Array, batch: Transition) -> tuple[Learned, Metrics]:
        target_key, loss_key = jax.random.split(key)
        target = jax.lax.stop_gradient(targets(config, learned, target_key, batch))
        gradient, metrics = jax.grad(loss, has_aux=True)(learned.params, config, loss_key, batch, target)
        changes, moments = _optimiser(config).update(gradient, learned.optimiser, learned.params)
        params: Any = optax.apply_updates(learned.params, changes)
        moved = replay.towards(learned.target, params["values"], _settings(config).target_rate)
        return Learned(params, moved, moments), metrics

    buffer, learned, metrics = replay.learned(config, state.buffer, trajectory, key, state.learned, step)
    return State(learned, buffer), metrics

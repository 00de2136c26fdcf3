"""What PPO and A2C share: a policy, if wanted a value network, and a round made ready to learn from."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, cast

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos.advantage import advantages
from iphyre_jax.train.algos.distributions import action_head
from iphyre_jax.train.algos.networks import POLICY_SCALE, VALUE_SCALE, Params, network
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import PolicyGradient
from iphyre_jax.train.settings.run import TrainConfig


class Batch(NamedTuple):
    """N decisions to learn from."""

    row: jax.Array  # (N,) int32, of the round's observations
    choice: jax.Array  # (N, ...)
    log_prob: jax.Array  # (N,) under the policy that decided
    advantage: jax.Array  # (N,)
    target: jax.Array  # (N,) of the value network, in units of 1000 points
    weight: jax.Array  # (N,) 1, or 0 for a decision that was not there


def settings_of(config: TrainConfig) -> PolicyGradient:
    """The settings of a configuration for a policy gradient."""
    return cast(PolicyGradient, config.learner)


def policy_network(config: TrainConfig) -> nn.Module:
    """From observations to the outputs of the action head."""
    return network(config, action_head(config.head).shape, POLICY_SCALE)


def value_network(config: TrainConfig) -> nn.Module:
    """From observations to values."""
    return network(config, (), VALUE_SCALE)


def init_params(config: TrainConfig, key: jax.Array, observation: jax.Array) -> Params:
    """Weights of the policy, and of the value network if there is one."""
    policy_key, value_key = jax.random.split(key)
    params = {"policy": policy_network(config).init(policy_key, observation)}
    if settings_of(config).critic:
        params["value"] = value_network(config).init(value_key, observation)
    return params


def value(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """(B,) values in units of 1000 points; 0 without a value network."""
    if "value" not in params:
        return jnp.zeros(observation.shape[0], jnp.float32)
    return cast(jax.Array, value_network(config).apply(params["value"], observation))


def outputs(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """Outputs for the action head."""
    return cast(jax.Array, policy_network(config).apply(params["policy"], observation))


@partial(jax.jit, static_argnums=(0, 4))
def act(config: TrainConfig, params: Params, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """Sample so many decisions for each observation (B, D), one observation after the other."""
    of_each = partial(jnp.repeat, repeats=each, axis=0)
    head, mask = action_head(config.head), of_each(slot_mask(observation))
    given = of_each(outputs(config, params, observation))
    choice = head.sample(key, given, mask)
    judged = of_each(value(config, params, observation))
    return Decision(head.action(choice), choice, head.log_prob(given, choice, mask), judged)


@partial(jax.jit, static_argnums=0)
def greedy(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """The most probable action for each observation (B, D)."""
    head = action_head(config.head)
    return head.action(head.mode(outputs(config, params, observation), slot_mask(observation)))


def optimiser(config: TrainConfig, passes: int) -> optax.GradientTransformation:
    """Adam on norm-limited gradients; its rate falls linearly to 0 over the run if so set."""
    settings = settings_of(config)
    steps = config.updates * passes * settings.minibatches
    rate = optax.linear_schedule(settings.learning_rate, 0.0, steps) if settings.anneal else settings.learning_rate
    return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), optax.adam(rate, eps=1e-5))


def entropy_weight(config: TrainConfig, made: jax.Array) -> jax.Array:
    """() weight of the entropy bonus after so many rounds."""
    settings = settings_of(config)
    left = 1.0 - made.astype(jnp.float32) / config.updates
    return settings.entropy * (left if settings.anneal else jnp.ones_like(left))


def batch_of(config: TrainConfig, trajectory: Trajectory, scenes: int) -> tuple[jax.Array, Batch]:
    """A round's observations (R, D), and its T x B decisions with their advantages.

    In advance all plans of a scene are made from one observation, R = S; else each decision has its own, R = T x B.
    """
    advantage, target = advantages(settings_of(config), trajectory, scenes)
    seen = trajectory.observation[:-1].reshape(-1, trajectory.observation.shape[-1])
    each = len(seen) // scenes if config.strategy == "in-advance" else 1
    whole = Batch(
        jnp.arange(len(seen), dtype=jnp.int32).reshape(advantage.shape) // each,
        trajectory.choice,
        trajectory.log_prob,
        advantage,
        target,
        trajectory.active.astype(jnp.float32),
    )
    return seen[::each], jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)


def judged(
    config: TrainConfig, params: Params, seen: jax.Array, row: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Outputs, values (N,) and slot masks (N, 6) for the observations (R, D) at rows (N,).

    Where there are fewer observations than decisions, the networks see each observation once. What comes out is spread
    by a product with ones and zeros, for the gradient of a gather is a scatter, which is slow on a CPU.
    """
    if len(seen) >= len(row):
        seen = seen[row]
        return outputs(config, params, seen), value(config, params, seen), slot_mask(seen)
    of = jax.nn.one_hot(row, len(seen))
    exactly = partial(jnp.einsum, "nr,r...->n...", of, precision=jax.lax.Precision.HIGHEST)
    return exactly(outputs(config, params, seen)), exactly(value(config, params, seen)), slot_mask(seen)[row]


def minibatches(config: TrainConfig, batch: Batch, key: jax.Array) -> Batch:
    """One pass: (minibatches, N / minibatches, ...) decisions in random order, those that were there first."""
    settings, count = settings_of(config), batch.weight.shape[0]
    rows = min(settings.rows, count) if settings.rows else count
    if rows == count:
        order = jax.random.permutation(key, count)
    else:
        order = jnp.argsort(jax.random.uniform(key, (count,)) + (1.0 - batch.weight))[:rows]
        order = jax.random.permutation(jax.random.fold_in(key, 1), order)  # those that were not there fall anywhere
    parts = order.reshape(settings.minibatches, -1)
    return jax.tree.map(lambda leaf: leaf[parts], batch)


def weighted(values: jax.Array, weight: jax.Array) -> jax.Array:
    """() mean over the decisions that were there."""
    return (values * weight).sum() / jnp.maximum(weight.sum(), 1.0)


def norm(tree: Any) -> jax.Array:  # noqa: ANN401 - any tree of arrays
    """() Euclidean norm of all numbers of a tree of arrays."""
    return jnp.sqrt(sum((jnp.square(leaf).sum() for leaf in jax.tree.leaves(tree)), jnp.zeros(())))

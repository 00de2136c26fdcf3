"""Proximal policy optimisation of plans made in advance.

An episode is one decision: the policy sees the start of a scene and gives a time to each block.
So there is nothing to bootstrap and no return to discount, and a round is

    plans, log-probabilities = collect     sample P plans for each of S scenes
    rewards                                play them (the caller does, on every core)
    advantage = scene_advantage            compare each plan with the others of its scene
    learn                                  E epochs of M minibatches with the clipped objective

The mean reward of a scene's own plans is the baseline, in place of a value network: it is exact for
the present policy up to sampling noise, and needs no training.

Shapes: S scenes, P plans a scene, B = S x P episodes in the order scene by scene.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax

from iphyre_jax.observe import OBSERVATION_SIZE, candidate_mask
from iphyre_jax.train.config import TrainConfig
from iphyre_jax.train.distributions import ActionHead, action_head
from iphyre_jax.train.networks import PlanNetwork

Params = Any  # the network's tree of arrays


class TrainState(NamedTuple):
    """All that a round changes."""

    params: Params
    optimiser: optax.OptState
    key: jax.Array  # random key of the rounds to come
    update: jax.Array  # () int32, rounds made


class Batch(NamedTuple):
    """Episodes to learn from."""

    observation: jax.Array  # (B, 120) float32
    choice: jax.Array  # (B, 6) as the action head samples them
    log_prob: jax.Array  # (B,) float32, of the choice under the policy that made it
    advantage: jax.Array  # (B,) float32


class Metrics(NamedTuple):
    """What a round reports, () float32 each, means over its minibatches."""

    policy_loss: jax.Array
    entropy: jax.Array  # nats per slot
    kl: jax.Array  # estimate of how far the policy moved in the round, nats per episode
    clipped: jax.Array  # share of episodes whose ratio left the clip range
    grad_norm: jax.Array  # before scaling


def network(config: TrainConfig) -> PlanNetwork:
    """The policy network of a configuration."""
    return PlanNetwork(config.hidden, action_head(config.head).outputs)


def policy(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """(B, 6, K) outputs of the network for observations (B, 120)."""
    return cast(jax.Array, network(config).apply(params, observation))


def optimiser(config: TrainConfig) -> optax.GradientTransformation:
    """Adam on norm-limited gradients, its rate falling linearly to 0 over the run."""
    steps = config.updates * config.epochs * config.minibatches
    rate = optax.linear_schedule(config.learning_rate, 0.0, steps)
    return optax.chain(optax.clip_by_global_norm(config.max_grad_norm), optax.adam(rate, eps=1e-5))


def init(config: TrainConfig) -> TrainState:
    """The state before the first round.

    Raises:
        ValueError: one line; a setting cannot work.
    """
    config.check()
    params_key, key = jax.random.split(jax.random.key(config.seed))
    params = network(config).init(params_key, jnp.zeros((1, OBSERVATION_SIZE), jnp.float32))
    return TrainState(params, optimiser(config).init(params), key, jnp.zeros((), jnp.int32))


def plan_log_prob(head: ActionHead, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
    """(B,) log-probability of whole plans; slots without a block do not count."""
    each = head.log_prob(outputs, choice)
    return jnp.where(mask, each, jnp.zeros_like(each)).sum(axis=-1)


def mean_entropy(head: ActionHead, outputs: jax.Array, mask: jax.Array) -> jax.Array:
    """() entropy per slot that stands for a block, nats."""
    each = head.entropy(outputs)
    return jnp.where(mask, each, jnp.zeros_like(each)).sum() / mask.sum()


@partial(jax.jit, static_argnums=0)
def collect(
    config: TrainConfig, params: Params, key: jax.Array, observation: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Sample a plan for each observation (B, 120): actions (B, 6), choices (B, 6), log-probabilities (B,)."""
    head = action_head(config.head)
    outputs = policy(config, params, observation)
    choice = head.sample(key, outputs)
    log_prob = plan_log_prob(head, outputs, choice, candidate_mask(observation))
    return head.action(choice), choice, log_prob


@partial(jax.jit, static_argnums=0)
def greedy(config: TrainConfig, params: Params, observation: jax.Array) -> jax.Array:
    """(B, 6) most probable action of each slot for observations (B, 120)."""
    head = action_head(config.head)
    return head.action(head.mode(policy(config, params, observation)))


def scene_advantage(reward: jax.Array, std_floor: float) -> jax.Array:
    """(S, P) rewards of P plans for each of S scenes -> (S, P) advantages (R - mean) / (std + floor) within a scene."""
    mean = reward.mean(axis=1, keepdims=True)
    std = reward.std(axis=1, keepdims=True)
    return (reward - mean) / (std + std_floor)


def clipped_objective(ratio: jax.Array, advantage: jax.Array, clip: float) -> jax.Array:
    """(B,) PPO's objective: min(r A, clip(r, 1 - c, 1 + c) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


def loss(params: Params, config: TrainConfig, batch: Batch, entropy_weight: jax.Array) -> tuple[jax.Array, Metrics]:
    """The loss of a minibatch and what to report of it."""
    head = action_head(config.head)
    mask = candidate_mask(batch.observation)
    outputs = policy(config, params, batch.observation)
    log_ratio = plan_log_prob(head, outputs, batch.choice, mask) - batch.log_prob
    ratio = jnp.exp(log_ratio)
    policy_loss = -clipped_objective(ratio, batch.advantage, config.clip).mean()
    entropy = mean_entropy(head, outputs, mask)
    metrics = Metrics(
        policy_loss=policy_loss,
        entropy=entropy,
        kl=(ratio - 1.0 - log_ratio).mean(),  # unbiased and never negative
        clipped=(jnp.abs(ratio - 1.0) > config.clip).mean(dtype=jnp.float32),
        grad_norm=jnp.zeros((), jnp.float32),
    )
    return policy_loss - entropy_weight * entropy, metrics


@partial(jax.jit, static_argnums=0)
def learn(config: TrainConfig, state: TrainState, batch: Batch) -> tuple[TrainState, Metrics]:
    """One round's epochs of minibatches."""
    key, shuffle_key = jax.random.split(state.key)
    entropy_weight = config.entropy * (1.0 - state.update.astype(jnp.float32) / config.updates)
    step = partial(_minibatch_step, config, entropy_weight)

    def epoch(
        carry: tuple[Params, optax.OptState], epoch_key: jax.Array
    ) -> tuple[tuple[Params, optax.OptState], Metrics]:
        order = jax.random.permutation(epoch_key, batch.advantage.shape[0]).reshape(config.minibatches, -1)
        minibatches = jax.tree.map(lambda leaf: leaf[order], batch)
        return jax.lax.scan(step, carry, minibatches)

    carry, metrics = jax.lax.scan(epoch, (state.params, state.optimiser), jax.random.split(shuffle_key, config.epochs))
    return TrainState(*carry, key, state.update + 1), jax.tree.map(jnp.mean, metrics)


def _minibatch_step(
    config: TrainConfig, entropy_weight: jax.Array, carry: tuple[Params, optax.OptState], minibatch: Batch
) -> tuple[tuple[Params, optax.OptState], Metrics]:
    """One gradient step."""
    params, optimiser_state = carry
    gradient, metrics = jax.grad(loss, has_aux=True)(params, config, minibatch, entropy_weight)
    changes, optimiser_state = optimiser(config).update(gradient, optimiser_state, params)
    metrics = metrics._replace(grad_norm=_norm(gradient))
    return (optax.apply_updates(params, changes), optimiser_state), metrics


def _norm(tree: Params) -> jax.Array:
    """() Euclidean norm of all numbers of a tree of arrays."""
    return jnp.sqrt(sum((jnp.square(leaf).sum() for leaf in jax.tree.leaves(tree)), jnp.zeros(())))

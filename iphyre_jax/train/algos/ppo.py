"""Proximal policy optimisation (Schulman et al. 2017), for all three strategies.

A round is

    decisions = act            sample from the policy, while the episodes are played (`collect.py`)
    advantage = advantages     generalised advantage estimation, normalised within each scene
    learn                      E passes of M minibatches with the clipped objective

In advance an episode is one decision: there is nothing to bootstrap, and by default no value network; the mean reward
of a scene's own plans is the baseline then. It is exact for the present policy up to sampling noise, and needs no
training.

Shapes: N decisions in a minibatch, D numbers in an observation.
"""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos import actor_critic
from iphyre_jax.train.algos.actor_critic import Batch, batch_of, entropy_weight, judged, minibatches, norm, weighted
from iphyre_jax.train.algos.distributions import action_head
from iphyre_jax.train.algos.networks import NOTHING, Params
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig

METRICS: Final = ("policy_loss", "value_loss", "entropy", "kl", "clipped", "grad_norm")
Metrics = dict[str, jax.Array]


class State(NamedTuple):
    """All that a round changes."""

    params: Params
    optimiser: optax.OptState
    kl_weight: jax.Array  # () float32
    made: jax.Array  # () int32, rounds


def _settings(config: TrainConfig) -> PPO:
    return cast(PPO, config.learner)


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round; observations (S, D) of the training games give sizes and centre."""
    params = actor_critic.init_params(config, key, observation)
    optimiser = actor_critic.optimiser(config, _settings(config).epochs)
    weight = jnp.asarray(_settings(config).kl_weight, jnp.float32)
    return State(params, optimiser.init(params), weight, jnp.zeros((), jnp.int32))


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """Sample so many decisions for each observation (B, D), one observation after the other."""
    return actor_critic.act(config, state.params, key, observation, each)


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """The most probable action for each observation (B, D)."""
    return actor_critic.greedy(config, state.params, observation)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return state._replace(params={"policy": state.params["policy"]}, optimiser=NOTHING)


def clipped_objective(ratio: jax.Array, advantage: jax.Array, clip: float) -> jax.Array:
    """(N,) PPO's objective: min(r A, clip(r, 1 - c, 1 + c) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip, 1.0 + clip) * advantage)


def loss(
    params: Params,
    config: TrainConfig,
    seen: jax.Array,
    batch: Batch,
    entropy_bonus: jax.Array,
    kl_weight: jax.Array,
) -> tuple[jax.Array, Metrics]:
    """The loss of a minibatch of decisions about observations (R, D), and what to report of it."""
    settings, head = _settings(config), action_head(config.head)
    given, value, mask = judged(config, params, seen, batch.row)
    log_ratio = (head.log_prob(given, batch.choice, mask) - batch.log_prob) * batch.weight
    ratio = jnp.exp(log_ratio)
    policy_loss = -weighted(clipped_objective(ratio, batch.advantage, settings.clip), batch.weight)
    squares = jnp.square(value - batch.target)
    if settings.value_clip:
        squares = jnp.minimum(squares, settings.value_clip)
    value_loss = weighted(squares, batch.weight) if settings.critic else jnp.zeros(())
    entropy = weighted(head.entropy(given, mask), batch.weight)
    kl = weighted(ratio - 1.0 - log_ratio, batch.weight)  # unbiased and never negative
    total = policy_loss + settings.value_weight * value_loss - entropy_bonus * entropy + kl_weight * kl
    clipped = weighted((jnp.abs(ratio - 1.0) > settings.clip).astype(jnp.float32), batch.weight)
    metrics = {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "kl": kl,
        "clipped": clipped,
    }
    return total, metrics


@partial(jax.jit, static_argnums=(0, 4))
def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Learn from a round's episodes of so many scenes; the new state and what to report, means over the minibatches."""
    settings = _settings(config)
    seen, batch = batch_of(config, trajectory, scenes)
    optimiser = actor_critic.optimiser(config, settings.epochs)
    bonus = entropy_weight(config, state.made)
    Carry = tuple[Params, optax.OptState]

    def step(carry: Carry, minibatch: Batch) -> tuple[Carry, Metrics]:
        params, moments = carry
        gradient, metrics = jax.grad(loss, has_aux=True)(params, config, seen, minibatch, bonus, state.kl_weight)
        changes, moments = optimiser.update(gradient, moments, params)
        return (optax.apply_updates(params, changes), moments), {**metrics, "grad_norm": norm(gradient)}

    def epoch(carry: Carry, key: jax.Array) -> tuple[Carry, Metrics]:
        return jax.lax.scan(step, carry, minibatches(config, batch, key))

    carry, metrics = jax.lax.scan(epoch, (state.params, state.optimiser), jax.random.split(key, settings.epochs))
    last_kl = metrics["kl"][-1].mean()
    return State(*carry, _adapted(settings, state.kl_weight, last_kl), state.made + 1), jax.tree.map(jnp.mean, metrics)


def _adapted(settings: PPO, weight: jax.Array, kl: jax.Array) -> jax.Array:
    """() the weight of the divergence for the next round: half as much again if it was too far, half if too near."""
    farther = jnp.where(kl > 2.0 * settings.kl_target, 1.5 * weight, weight)
    return jnp.where(kl < 0.5 * settings.kl_target, 0.5 * weight, farther)

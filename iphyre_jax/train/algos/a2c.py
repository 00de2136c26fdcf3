"""Advantage actor-critic (Mnih et al. 2016, the synchronous form), for all three strategies.

The plain policy gradient: each decision of a round is used once, in one of M gradient steps, with the advantage as its
weight. The episodes are played and compared as for PPO (`ppo.py`).

Shapes: N decisions in a minibatch, D numbers in an observation.
"""

from __future__ import annotations

from functools import partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos import actor_critic
from iphyre_jax.train.algos.actor_critic import (
    Batch,
    batch_of,
    entropy_weight,
    judged,
    minibatches,
    norm,
    settings_of,
    weighted,
)
from iphyre_jax.train.algos.distributions import action_head
from iphyre_jax.train.algos.networks import NOTHING, Params
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.settings.run import TrainConfig

METRICS: Final = ("policy_loss", "value_loss", "entropy", "grad_norm")
Metrics = dict[str, jax.Array]


class State(NamedTuple):
    """All that a round changes."""

    params: Params
    optimiser: optax.OptState
    made: jax.Array  # () int32, rounds


def init(config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
    """The state before the first round; observations (S, D) of the training games give sizes and centre."""
    params = actor_critic.init_params(config, key, observation)
    return State(params, actor_critic.optimiser(config, 1).init(params), jnp.zeros((), jnp.int32))


def act(config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
    """Sample so many decisions for each observation (B, D), one observation after the other."""
    return actor_critic.act(config, state.params, key, observation, each)


def greedy(config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
    """The most probable action for each observation (B, D)."""
    return actor_critic.greedy(config, state.params, observation)


def acting(state: State) -> State:
    """The state with nothing left in it but what `act` and `greedy` look at."""
    return state._replace(params={"policy": state.params["policy"]}, optimiser=NOTHING)


def loss(
    params: Params, config: TrainConfig, seen: jax.Array, batch: Batch, entropy_bonus: jax.Array
) -> tuple[jax.Array, Metrics]:
    """The loss of a minibatch of decisions about observations (R, D), and what to report of it."""
    settings, head = settings_of(config), action_head(config.head)
    given, value, mask = judged(config, params, seen, batch.row)
    log_prob = head.log_prob(given, batch.choice, mask)
    policy_loss = -weighted(log_prob * batch.advantage, batch.weight)
    squares = jnp.square(value - batch.target)
    value_loss = weighted(squares, batch.weight) if settings.critic else jnp.zeros(())
    entropy = weighted(head.entropy(given, mask), batch.weight)
    total = policy_loss + settings.value_weight * value_loss - entropy_bonus * entropy
    return total, {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}


@partial(jax.jit, static_argnums=(0, 4))
def learn(
    config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
) -> tuple[State, Metrics]:
    """Learn from a round's episodes of so many scenes; the new state and what to report, means over the minibatches."""
    seen, batch = batch_of(config, trajectory, scenes)
    optimiser = actor_critic.optimiser(config, 1)
    bonus = entropy_weight(config, state.made)
    Carry = tuple[Params, optax.OptState]

    def step(carry: Carry, minibatch: Batch) -> tuple[Carry, Metrics]:
        params, moments = carry
        gradient, metrics = jax.grad(loss, has_aux=True)(params, config, seen, minibatch, bonus)
        changes, moments = optimiser.update(gradient, moments, params)
        return (optax.apply_updates(params, changes), moments), {**metrics, "grad_norm": norm(gradient)}

    start = state.params, state.optimiser
    (params, moments), metrics = jax.lax.scan(step, start, minibatches(config, batch, key))
    return State(params, moments, state.made + 1), jax.tree.map(jnp.mean, metrics)

"""Advantage actor-critic (Mnih et al. 2016, the synchronous form), for all three strategies.

The plain policy gradient: an update uses each decision once, in one of its gradient steps, with the advantage as its
weight. Episodes are played and compared as for PPO (`ppo.py`).
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.train.algos.actor_critic import ActorCritic, Batch, State
from iphyre_jax.train.algos.base import Metrics, jitted, masked_mean
from iphyre_jax.train.algos.networks import Params
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import A2C


class A2CAlgorithm(ActorCritic[A2C]):
    """Advantage actor-critic."""

    METRICS = ("policy_loss", "value_loss", "entropy", "grad_norm")

    def loss(self, params: Params, obs: jax.Array, batch: Batch, ent_coef: jax.Array) -> tuple[jax.Array, Metrics]:
        """The loss of a minibatch of decisions about observations (R, D), and metrics."""
        log_prob, entropy, value = self.evaluate_actions(params, obs, batch)
        policy_loss = -masked_mean(log_prob * batch.advantage, batch.weight)
        squares = jnp.square(value - batch.target)
        value_loss = masked_mean(squares, batch.weight) if self.settings.critic else jnp.zeros(())
        entropy = masked_mean(entropy, batch.weight)
        total = policy_loss + self.settings.vf_coef * value_loss - ent_coef * entropy
        return total, {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy}

    @jitted(0, 4)
    def learn(self, state: State, key: jax.Array, trajectory: Trajectory, num_scenes: int) -> tuple[State, Metrics]:
        """See `Algorithm`; metrics are means over the minibatches."""
        obs, batch = self.batch(trajectory, num_scenes)
        ent_coef = self.entropy_weight(state.num_updates)
        step = partial(self.gradient_step, partial(self.loss, ent_coef=ent_coef), obs)
        start = state.params, state.opt_state
        (params, opt_state), metrics = jax.lax.scan(step, start, self.minibatches(batch, key, num_scenes))
        return State(params, opt_state, state.num_updates + 1), jax.tree.map(jnp.mean, metrics)

"""Proximal policy optimisation (Schulman et al. 2017), for all three strategies.

An update is

    sample_action    sample from the policy, while the episodes are played (`collect.py`)
    advantages       generalised advantage estimation, normalised within each scene
    learn            E passes of M minibatches with the clipped objective

In advance an episode is one decision, so there is nothing to bootstrap and by default no value network. The mean reward
of a scene's own plans is the baseline: exact for the present policy up to sampling noise, without training.

Shapes: N decisions in a minibatch, R observations of them, D numbers in an observation.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp

from iphyre_jax.train.algos.actor_critic import ActorCritic, Batch, Carry, State
from iphyre_jax.train.algos.base import Metrics, jitted, masked_mean
from iphyre_jax.train.algos.networks import Params
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import PPO


def clipped_objective(ratio: jax.Array, advantage: jax.Array, clip_eps: float) -> jax.Array:
    """(N,) PPO's objective: min(r A, clip(r, 1 - c, 1 + c) A)."""
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1.0 - clip_eps, 1.0 + clip_eps) * advantage)


class PPOAlgorithm(ActorCritic[PPO]):
    """Proximal policy optimisation."""

    METRICS = ("policy_loss", "value_loss", "entropy", "kl", "clipped", "grad_norm")

    @property
    def epochs(self) -> int:
        """Passes over the decisions of an update."""
        return self.settings.epochs

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        return super().init(key, obs)._replace(kl_coef=jnp.asarray(self.settings.kl_coef, jnp.float32))

    def loss(
        self, params: Params, obs: jax.Array, batch: Batch, ent_coef: jax.Array, kl_coef: jax.Array
    ) -> tuple[jax.Array, Metrics]:
        """The loss of a minibatch of decisions about observations (R, D), and metrics."""
        settings = self.settings
        log_prob, entropy, value = self.evaluate_actions(params, obs, batch)
        log_ratio = (log_prob - batch.log_prob) * batch.weight
        ratio = jnp.exp(log_ratio)
        policy_loss = -masked_mean(clipped_objective(ratio, batch.advantage, settings.clip_eps), batch.weight)
        squares = jnp.square(value - batch.target)
        if settings.value_clip:
            squares = jnp.minimum(squares, settings.value_clip)
        value_loss = masked_mean(squares, batch.weight) if settings.critic else jnp.zeros(())
        entropy = masked_mean(entropy, batch.weight)
        kl = masked_mean(ratio - 1.0 - log_ratio, batch.weight)  # unbiased and never negative
        total = policy_loss + settings.vf_coef * value_loss - ent_coef * entropy + kl_coef * kl
        clipped = masked_mean((jnp.abs(ratio - 1.0) > settings.clip_eps).astype(jnp.float32), batch.weight)
        metrics = {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy, "kl": kl}
        return total, {**metrics, "clipped": clipped}

    @jitted(0, 4)
    def learn(self, state: State, key: jax.Array, trajectory: Trajectory, num_scenes: int) -> tuple[State, Metrics]:
        """See `Algorithm`; metrics are means over the minibatches."""
        obs, batch = self.batch(trajectory, num_scenes)
        ent_coef = self.entropy_weight(state.num_updates)
        loss = partial(self.loss, ent_coef=ent_coef, kl_coef=state.kl_coef)
        step = partial(self.gradient_step, loss, obs)

        def epoch(carry: Carry, key: jax.Array) -> tuple[Carry, Metrics]:
            return jax.lax.scan(step, carry, self.minibatches(batch, key, num_scenes))

        keys = jax.random.split(key, self.epochs)
        (params, opt_state), metrics = jax.lax.scan(epoch, (state.params, state.opt_state), keys)
        kl_coef = self.adapted(state.kl_coef, metrics["kl"][-1].mean())
        return State(params, opt_state, state.num_updates + 1, kl_coef), jax.tree.map(jnp.mean, metrics)

    def adapted(self, kl_coef: jax.Array, kl: jax.Array) -> jax.Array:
        """() weight of the divergence in the next update: 1.5 times if it was too far, half if it was too near."""
        farther = jnp.where(kl > 2.0 * self.settings.kl_target, 1.5 * kl_coef, kl_coef)
        return jnp.where(kl < 0.5 * self.settings.kl_target, 0.5 * kl_coef, farther)

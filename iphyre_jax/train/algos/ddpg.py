"""Deep deterministic policy gradient (Lillicrap et al. 2016), in advance.

One network gives the times, another values them; the first follows the gradient of the second. Noise is added to the
times while episodes are played.

Shapes: N transitions, D numbers in an observation.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos.base import Metrics, descend, forward, jitted, without_value
from iphyre_jax.train.algos.distributions import DeterministicHead
from iphyre_jax.train.algos.networks import NOTHING, POLICY_SCALE, VALUE_SCALE, Params
from iphyre_jax.train.algos.off_policy import OffPolicyAlgorithm, State, linear_schedule, polyak_update
from iphyre_jax.train.algos.replay import Transition
from iphyre_jax.train.collect import PolicyOutput
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import DDPG

HEAD: Final = DeterministicHead()


class TrainState(NamedTuple):
    """What gradient steps change."""

    policy: Params
    value: Params
    target_policy: Params
    target_value: Params
    policy_opt_state: optax.OptState
    value_opt_state: optax.OptState


class DDPGAlgorithm(OffPolicyAlgorithm[DDPG]):
    """Deep deterministic policy gradient."""

    METRICS = ("policy_loss", "value_loss", "noise")

    @property
    def optimizers(self) -> tuple[optax.GradientTransformation, optax.GradientTransformation]:
        """Of the policy and of the value."""
        return optax.adam(self.settings.actor_lr), optax.adam(self.settings.learning_rate)

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        policy_key, value_key = jax.random.split(key)
        action = jnp.zeros((len(obs), HEAD.shape[0]), jnp.float32)
        policy = self.network(HEAD.shape, POLICY_SCALE).init(policy_key, obs)
        value = self.network((), VALUE_SCALE).init(value_key, jnp.concatenate([obs, action], axis=-1))
        targets = jax.tree.map(jnp.copy, (policy, value))
        opt_states = (opt.init(params) for opt, params in zip(self.optimizers, (policy, value), strict=True))
        train_state = TrainState(policy, value, *targets, *opt_states)
        return State(train_state, self.empty_buffer(obs, action), jnp.zeros((), jnp.int32))

    def action(self, policy: Params, obs: jax.Array) -> jax.Array:
        """(N, 6) the policy's times as shares of 15 s."""
        outputs = forward(self.network(HEAD.shape, POLICY_SCALE), policy, obs)
        return HEAD.action(HEAD.mode(outputs))

    def value(self, value: Params, obs: jax.Array, action: jax.Array) -> jax.Array:
        """(N,) values of times; those of slots without a block do not count."""
        return forward(self.network((), VALUE_SCALE), value, jnp.concatenate([obs, action * slot_mask(obs)], axis=-1))

    def noise(self, num_updates: jax.Array) -> jax.Array:
        """() standard deviation of the noise after so many updates."""
        settings = self.settings
        return linear_schedule(num_updates, settings.noise, settings.noise_end, settings.noise_updates)

    @jitted(0, 4)
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """See `Algorithm`: the policy's times with noise; uniform times in the first updates."""
        obs = jnp.repeat(obs, num_samples, axis=0)
        noise_key, uniform_key = jax.random.split(key)
        planned = self.action(state.train_state.policy, obs)
        noise = self.noise(state.num_updates) * jax.random.normal(noise_key, planned.shape, planned.dtype)
        uniform = jax.random.uniform(uniform_key, planned.shape, planned.dtype)
        random = state.num_updates < self.settings.random_updates
        action = jnp.where(random, uniform, jnp.clip(planned + noise, 0.0, 1.0))
        return without_value(action, action)

    @jitted(0)
    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """The policy's times for each observation (B, D)."""
        return self.action(state.train_state.policy, obs)

    def inference_state(self, state: State) -> State:
        """See `Algorithm`."""
        return State(TrainState(state.train_state.policy, *[NOTHING] * 5), NOTHING, state.num_updates)

    def value_loss(self, value: Params, train_state: TrainState, batch: Transition) -> jax.Array:
        """() squared distance of the values from reward + discount Q' of the next observation."""
        next_action = self.action(train_state.target_policy, batch.next_obs)
        next_value = self.value(train_state.target_value, batch.next_obs, next_action)
        target = batch.reward + batch.discount * next_value
        error = self.value(value, batch.obs, batch.raw_action) - jax.lax.stop_gradient(target)
        return jnp.square(error).mean()

    def policy_loss(self, policy: Params, value: Params, batch: Transition) -> jax.Array:
        """() minus the value of the policy's times."""
        return -self.value(value, batch.obs, self.action(policy, batch.obs)).mean()

    def gradient_step(
        self, num_updates: jax.Array, train_state: TrainState, key: jax.Array, batch: Transition
    ) -> tuple[TrainState, Metrics]:
        """See `OffPolicyAlgorithm`."""
        del key
        policy_optimizer, value_optimizer = self.optimizers
        value_loss, gradient = jax.value_and_grad(self.value_loss)(train_state.value, train_state, batch)
        value, value_opt_state = descend(value_optimizer, gradient, train_state.value, train_state.value_opt_state)
        policy_loss, gradient = jax.value_and_grad(self.policy_loss)(train_state.policy, value, batch)
        policy, policy_opt_state = descend(policy_optimizer, gradient, train_state.policy, train_state.policy_opt_state)
        targets = polyak_update(
            (train_state.target_policy, train_state.target_value), (policy, value), self.settings.tau
        )
        metrics = {"policy_loss": policy_loss, "value_loss": value_loss, "noise": self.noise(num_updates)}
        return TrainState(policy, value, *targets, policy_opt_state, value_opt_state), metrics

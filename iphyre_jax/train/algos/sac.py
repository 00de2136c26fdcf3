"""Soft actor-critic (Haarnoja et al. 2018; discrete: Christodoulou 2019), for all three strategies.

The policy maximises reward plus alpha times entropy; alpha is learned so that the entropy stays at its target. One form
serves times and the seven actions on the fly: an expectation over candidate actions, each with a log-probability, a
weight and a value. On the fly the candidates are all seven, weighted by their probabilities; times are one sample of
weight 1.

Shapes: N transitions, A candidates of each (7 on the fly, else 1), D numbers in an observation.
"""

from __future__ import annotations

from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos.base import Metrics, descend, forward, jitted, without_value
from iphyre_jax.train.algos.distributions import CategoricalHead
from iphyre_jax.train.algos.networks import NOTHING, POLICY_SCALE, VALUE_SCALE, Params
from iphyre_jax.train.algos.off_policy import OffPolicyAlgorithm, State, polyak_update
from iphyre_jax.train.algos.replay import Transition
from iphyre_jax.train.collect import PolicyOutput
from iphyre_jax.train.hazard import Hazard, median_action
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import SAC


class TrainState(NamedTuple):
    """What gradient steps change."""

    params: Params  # "policy", "values" (two networks), "log_alpha"
    target: Params  # of the two value networks
    opt_state: optax.OptState


class Candidates(NamedTuple):
    """The actions that an expectation goes over, for each of N observations."""

    log_prob: jax.Array  # (N, A)
    weight: jax.Array  # (N, A), sums to 1
    raw_action: jax.Array  # (N, 6) the sample; on the fly (N, 7) log-probabilities, which nothing reads


class SACAlgorithm(OffPolicyAlgorithm[SAC]):
    """Soft actor-critic."""

    METRICS = ("policy_loss", "value_loss", "entropy", "alpha")

    @property
    def discrete(self) -> bool:
        """Whether an action is one of seven, not a time for each slot."""
        return isinstance(self.head, CategoricalHead)

    @property
    def policy_network(self) -> nn.Module:
        """From observations to the outputs of the action head."""
        return self.network(self.head.shape, POLICY_SCALE)

    @property
    def value_network(self) -> nn.Module:
        """From observations to the values of all seven actions, or from observations with times to their value."""
        return self.network(self.head.shape if self.discrete else (), VALUE_SCALE)

    @property
    def optimizer(self) -> optax.GradientTransformation:
        """Adam."""
        return optax.adam(self.settings.learning_rate)

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        policy_key, *value_keys = jax.random.split(key, 3)
        raw_action, value_input = jnp.zeros((1,), jnp.int32), obs
        if not self.discrete:
            raw_action = jnp.zeros((len(obs), self.head.shape[0]), jnp.float32)
            value_input = jnp.concatenate([obs, raw_action], axis=-1)
        values = tuple(self.value_network.init(value_key, value_input) for value_key in value_keys)
        params = {
            "policy": self.policy_network.init(policy_key, obs),
            "values": values,
            "log_alpha": jnp.log(jnp.asarray(self.settings.alpha, jnp.float32)),
        }
        train_state = TrainState(params, jax.tree.map(jnp.copy, values), self.optimizer.init(params))
        return State(train_state, self.empty_buffer(obs, raw_action))

    def values(self, both: Params, obs: jax.Array, raw_action: jax.Array) -> jax.Array:
        """(2, N, A) values by the two networks: of all seven actions, or of the raw action."""
        if self.discrete:
            return jnp.stack([forward(self.value_network, params, obs) for params in both])
        action = self.head.action(raw_action) * slot_mask(obs)
        value_input = jnp.concatenate([obs, action], axis=-1)
        return jnp.stack([forward(self.value_network, params, value_input)[:, None] for params in both])

    def distribution(self, policy: Params, obs: jax.Array) -> jax.Array:
        """The action head's distribution for each observation."""
        return self.head.distribution(forward(self.policy_network, policy, obs), slot_mask(obs))

    def candidates(self, policy: Params, key: jax.Array, obs: jax.Array) -> Candidates:
        """The actions that an expectation under the policy goes over."""
        head, distribution = self.head, self.distribution(policy, obs)
        if isinstance(head, CategoricalHead):  # the distribution is log-probabilities
            # An action of probability 0 counts in no mean, but -inf times 0 is NaN.
            return Candidates(jnp.maximum(distribution, -1e3), jnp.exp(distribution), distribution)
        raw_action = head.sample(key, distribution)
        log_prob = head.log_prob(distribution, raw_action, slot_mask(obs))[:, None]
        return Candidates(log_prob, jnp.ones_like(log_prob), raw_action)

    @jitted(0, 4)
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """See `Algorithm`."""
        obs = jnp.repeat(obs, num_samples, axis=0)
        raw_action = self.head.sample(key, self.distribution(state.train_state.params["policy"], obs))
        return without_value(self.head.action(raw_action), raw_action)

    @jitted(0)
    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """The most probable action for each observation (B, D)."""
        return self.head.action(self.head.mode(self.distribution(state.train_state.params["policy"], obs)))

    @jitted(0)
    def median(self, state: State, obs: jax.Array, hazard: Hazard) -> tuple[jax.Array, Hazard]:
        """See `Algorithm`."""
        # The settings allow only categorical heads on the fly.
        return median_action(hazard, self.distribution(state.train_state.params["policy"], obs))

    def inference_state(self, state: State) -> State:
        """See `Algorithm`."""
        return State(TrainState({"policy": state.train_state.params["policy"]}, NOTHING, NOTHING), NOTHING)

    def targets(self, train_state: TrainState, key: jax.Array, batch: Transition) -> jax.Array:
        """(N,) targets of the values: reward + discount E[min Q' - alpha log pi] of the next observation."""
        found = self.candidates(train_state.params["policy"], key, batch.next_obs)
        values = self.values(train_state.target, batch.next_obs, found.raw_action).min(axis=0)
        alpha = jnp.exp(train_state.params["log_alpha"])
        soft = (found.weight * (values - alpha * found.log_prob)).sum(axis=-1)
        return batch.reward + batch.discount * soft

    def loss(self, params: Params, key: jax.Array, batch: Transition, target: jax.Array) -> tuple[jax.Array, Metrics]:
        """The sum of three losses that share no weights: of the values, of the policy, of alpha."""
        values = self.values(params["values"], batch.obs, batch.raw_action)
        taken = values[..., 0]
        if self.discrete:
            taken = jnp.take_along_axis(values, batch.raw_action[None, :, None], axis=-1)[..., 0]
        value_loss = jnp.square(taken - target[None]).mean()
        found = self.candidates(params["policy"], key, batch.obs)
        fixed = jax.lax.stop_gradient(params["values"])
        value = self.values(fixed, batch.obs, found.raw_action).min(axis=0)
        alpha = jnp.exp(params["log_alpha"])
        cost = jax.lax.stop_gradient(alpha) * found.log_prob - value
        policy_loss = (found.weight * cost).sum(axis=-1).mean()
        entropy = -(found.weight * found.log_prob).sum(axis=-1)
        blocks = jnp.ones_like(entropy) if self.discrete else slot_mask(batch.obs).sum(axis=-1)
        surplus = jax.lax.stop_gradient(entropy - blocks * self.settings.target_entropy)
        alpha_loss = (params["log_alpha"] * surplus).mean()
        metrics = {"policy_loss": policy_loss, "value_loss": value_loss, "entropy": entropy.mean()}
        return value_loss + policy_loss + alpha_loss, {**metrics, "alpha": alpha}

    def gradient_step(
        self, num_updates: jax.Array, train_state: TrainState, key: jax.Array, batch: Transition
    ) -> tuple[TrainState, Metrics]:
        """See `OffPolicyAlgorithm`."""
        del num_updates
        target_key, loss_key = jax.random.split(key)
        target = jax.lax.stop_gradient(self.targets(train_state, target_key, batch))
        gradient, metrics = jax.grad(self.loss, has_aux=True)(train_state.params, loss_key, batch, target)
        params, opt_state = descend(self.optimizer, gradient, train_state.params, train_state.opt_state)
        target_params = polyak_update(train_state.target, params["values"], self.settings.tau)
        return TrainState(params, target_params, opt_state), metrics

"""Deep Q-network (Mnih et al. 2015) with double learning and two streams, on the fly.

A network values all seven actions. The best is taken, but for a share epsilon of random ones. Most of those do nothing:
a decision comes every 0.1 s, and removed blocks do not come back.

Shapes: N transitions, D numbers in an observation.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos.base import Metrics, descend, forward, jitted, without_value
from iphyre_jax.train.algos.distributions import CategoricalHead
from iphyre_jax.train.algos.networks import NOTHING, VALUE_SCALE, Params
from iphyre_jax.train.algos.off_policy import OffPolicyAlgorithm, State, linear_schedule, polyak_update
from iphyre_jax.train.algos.replay import Transition
from iphyre_jax.train.collect import PolicyOutput
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import DQN

IMPOSSIBLE: Final = -1e3  # value of removing a block that a slot does not have


class TrainState(NamedTuple):
    """What gradient steps change."""

    value: Params
    target: Params
    opt_state: optax.OptState


class DQNAlgorithm(OffPolicyAlgorithm[DQN]):
    """Deep Q-network."""

    METRICS = ("value_loss", "epsilon")

    @property
    def optimizer(self) -> optax.GradientTransformation:
        """Adam."""
        return optax.adam(self.settings.learning_rate)

    @property
    def exploration(self) -> CategoricalHead:
        """The distribution of random actions, over the actions that the head offers."""
        head = cast("CategoricalHead", self.head)  # the settings allow no other
        return replace(head, no_op_prob=self.settings.no_op_prob)

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        value = self.network(CategoricalHead.shape, VALUE_SCALE, dueling=self.settings.dueling).init(key, obs)
        train_state = TrainState(value, jax.tree.map(jnp.copy, value), self.optimizer.init(value))
        return State(train_state, self.empty_buffer(obs, jnp.zeros((1,), jnp.int32)), jnp.zeros((), jnp.int32))

    def values(self, params: Params, obs: jax.Array) -> jax.Array:
        """(N, 7) values of the actions; those that the head does not offer are far below all others."""
        possible = self.exploration.offered(slot_mask(obs))
        network = self.network(CategoricalHead.shape, VALUE_SCALE, dueling=self.settings.dueling)
        return jnp.where(possible, forward(network, params, obs), IMPOSSIBLE)

    def best(self, params: Params, obs: jax.Array) -> jax.Array:
        """(N,) int32 the actions of highest value."""
        return self.values(params, obs).argmax(axis=-1).astype(jnp.int32)

    def epsilon(self, num_updates: jax.Array) -> jax.Array:
        """() share of random actions after so many updates."""
        settings = self.settings
        return linear_schedule(num_updates, settings.epsilon, settings.epsilon_end, settings.epsilon_updates)

    @jitted(0, 4)
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """See `Algorithm`: the best action, but for a share of random ones."""
        obs = jnp.repeat(obs, num_samples, axis=0)
        share_key, random_key = jax.random.split(key)
        random_head, mask = self.exploration, slot_mask(obs)
        no_preference = jnp.zeros((*mask.shape[:-1], *random_head.shape), jnp.float32)
        random = random_head.sample(random_key, random_head.distribution(no_preference, mask))
        best = self.best(state.train_state.value, obs)
        explores = jax.random.uniform(share_key, best.shape, jnp.float32) < self.epsilon(state.num_updates)
        action = jnp.where(explores, random, best)
        return without_value(action, action)

    @jitted(0)
    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """The best action for each observation (B, D)."""
        return self.best(state.train_state.value, obs)

    def inference_state(self, state: State) -> State:
        """See `Algorithm`."""
        return State(TrainState(state.train_state.value, NOTHING, NOTHING), NOTHING, state.num_updates)

    def targets(self, train_state: TrainState, batch: Transition) -> jax.Array:
        """(N,) targets of the values: reward + discount Q' of the best next action."""
        next_values = self.values(train_state.target, batch.next_obs)
        chooser = train_state.value if self.settings.double else train_state.target
        best = self.values(chooser, batch.next_obs).argmax(axis=-1)
        return batch.reward + batch.discount * jnp.take_along_axis(next_values, best[:, None], axis=-1)[:, 0]

    def loss(self, value: Params, batch: Transition, target: jax.Array) -> jax.Array:
        """() squared distance of the values of the actions from their targets."""
        values = self.values(value, batch.obs)
        taken = jnp.take_along_axis(values, batch.raw_action[:, None], axis=-1)[:, 0]
        return jnp.square(taken - target).mean()

    def gradient_step(
        self, num_updates: jax.Array, train_state: TrainState, key: jax.Array, batch: Transition
    ) -> tuple[TrainState, Metrics]:
        """See `OffPolicyAlgorithm`."""
        del key
        target = jax.lax.stop_gradient(self.targets(train_state, batch))
        value_loss, gradient = jax.value_and_grad(self.loss)(train_state.value, batch, target)
        value, opt_state = descend(self.optimizer, gradient, train_state.value, train_state.opt_state)
        target_params = polyak_update(train_state.target, value, self.settings.tau)
        metrics = {"value_loss": value_loss, "epsilon": self.epsilon(num_updates)}
        return TrainState(value, target_params, opt_state), metrics

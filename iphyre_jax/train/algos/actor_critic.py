"""What PPO and A2C share: a policy, an optional value network, and minibatches of an update.

Shapes: S scenes, B episodes, T decisions of each, N decisions to learn from, R distinct observations of them, D numbers
in an observation.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, TypeVar

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

from iphyre_jax.train.algos.advantage import advantages
from iphyre_jax.train.algos.base import Algorithm, Metrics, active_first, descend, forward, global_norm, jitted
from iphyre_jax.train.algos.networks import NOTHING, POLICY_SCALE, VALUE_SCALE, Params
from iphyre_jax.train.collect import PolicyOutput, Trajectory
from iphyre_jax.train.hazard import Hazard, median_action
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.agents import PolicyGradient

S = TypeVar("S", bound=PolicyGradient)
Carry = tuple[Params, optax.OptState]


class State(NamedTuple):
    """All that an update changes."""

    params: Params  # "policy" and, with a critic, "value"; or "members", the policies of an ensemble
    opt_state: optax.OptState
    num_updates: jax.Array  # () int32
    kl_coef: Any = NOTHING  # () float32, of PPO


class Batch(NamedTuple):
    """N decisions to learn from."""

    row: jax.Array  # (N,) int32, index of the decision's observation
    raw_action: jax.Array  # (N, ...)
    log_prob: jax.Array  # (N,) under the policy that decided
    advantage: jax.Array  # (N,)
    target: jax.Array  # (N,) of the value network, in units of 1000 points
    weight: jax.Array  # (N,) 1, or 0 for a decision after the end of its episode


class Minibatch(NamedTuple):
    """What a gradient step learns from."""

    decisions: Batch  # their rows point into `obs_rows`
    obs_rows: Any = None  # (r,) int32, the observations that they are about; None for all


class ActorCritic(Algorithm[S]):
    """A policy gradient."""

    @property
    def epochs(self) -> int:
        """Passes over the decisions of an update."""
        return 1

    @property
    def policy_network(self) -> nn.Module:
        """From observations to the outputs of the action head."""
        return self.network(self.head.shape, POLICY_SCALE)

    @property
    def value_network(self) -> nn.Module:
        """From observations to values."""
        return self.network((), VALUE_SCALE)

    @property
    def optimizer(self) -> optax.GradientTransformation:
        """Adam on norm-limited gradients; its rate can fall linearly to 0 over the run."""
        settings = self.settings
        steps = self.config.updates * self.epochs * settings.minibatches
        initial = settings.learning_rate
        rate = optax.linear_schedule(initial, 0.0, steps) if settings.anneal_lr else initial
        return optax.chain(optax.clip_by_global_norm(settings.max_grad_norm), optax.adam(rate, eps=1e-5))

    def init(self, key: jax.Array, obs: jax.Array) -> State:
        """See `Algorithm`."""
        policy_key, value_key = jax.random.split(key)
        params = {"policy": self.policy_network.init(policy_key, obs)}
        if self.settings.critic:
            params["value"] = self.value_network.init(value_key, obs)
        return State(params, self.optimizer.init(params), jnp.zeros((), jnp.int32))

    def value(self, params: Params, obs: jax.Array) -> jax.Array:
        """(B,) values in units of 1000 points; 0 without a value network."""
        if "value" not in params:
            return jnp.zeros(obs.shape[0], jnp.float32)
        return forward(self.value_network, params["value"], obs)

    def distribution(self, params: Params, obs: jax.Array) -> jax.Array:
        """The action head's distribution for each observation; of an ensemble, the normalised product of all."""
        members, mask = params["members"] if "members" in params else (params["policy"],), slot_mask(obs)
        each = [self.head.distribution(forward(self.policy_network, one, obs), mask) for one in members]
        return each[0] if len(each) == 1 else jax.nn.log_softmax(sum(each[1:], each[0]) / len(each))

    @jitted(0, 4)
    def sample_action(self, state: State, key: jax.Array, obs: jax.Array, num_samples: int = 1) -> PolicyOutput:
        """See `Algorithm`; the networks see each observation once."""
        repeat = partial(jnp.repeat, repeats=num_samples, axis=0)
        head, mask = self.head, repeat(slot_mask(obs))
        distribution = repeat(self.distribution(state.params, obs))
        raw_action = head.sample(key, distribution)
        value = repeat(self.value(state.params, obs))
        return PolicyOutput(head.action(raw_action), raw_action, head.log_prob(distribution, raw_action, mask), value)

    @jitted(0)
    def greedy(self, state: State, obs: jax.Array) -> jax.Array:
        """The most probable action for each observation (B, D)."""
        return self.head.action(self.head.mode(self.distribution(state.params, obs)))

    @jitted(0)
    def median(self, state: State, obs: jax.Array, hazard: Hazard) -> tuple[jax.Array, Hazard]:
        """See `Algorithm`."""
        return median_action(hazard, self.distribution(state.params, obs))  # the settings allow only categorical heads

    def inference_state(self, state: State) -> State:
        """See `Algorithm`."""
        return state._replace(params={k: v for k, v in state.params.items() if k != "value"}, opt_state=NOTHING)

    def entropy_weight(self, num_updates: jax.Array) -> jax.Array:
        """() weight of the entropy bonus after so many updates."""
        left = 1.0 - num_updates.astype(jnp.float32) / self.config.updates
        return self.settings.ent_coef * (left if self.settings.anneal_lr else jnp.ones_like(left))

    def batch(self, trajectory: Trajectory, num_scenes: int) -> tuple[jax.Array, Batch]:
        """The observations (R, D) of an update, and its T x B decisions with their advantages.

        In advance all plans of a scene come from one observation, R = S; else each decision has its own, R = T x B.
        """
        advantage, target = advantages(self.settings, trajectory, num_scenes)
        obs = trajectory.obs[:-1].reshape(-1, trajectory.obs.shape[-1])
        sharing = len(obs) // num_scenes if self.config.strategy == "in-advance" else 1
        whole = Batch(
            jnp.arange(len(obs), dtype=jnp.int32).reshape(advantage.shape) // sharing,
            trajectory.raw_action,
            trajectory.log_prob,
            advantage,
            target,
            trajectory.active.astype(jnp.float32),
        )
        return obs[::sharing], jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), whole)

    def evaluate_actions(self, params: Params, obs: jax.Array, batch: Batch) -> tuple[jax.Array, jax.Array, jax.Array]:
        """(N,) each: log-probabilities of decisions about observations (R, D), entropies, values.

        With fewer observations than decisions, networks, normalisation and entropy see each observation once. A product
        with ones and zeros then spreads them: the gradient of a gather is a scatter, which is slow on a CPU.
        """
        row, spread = batch.row, _same
        if len(obs) >= len(row):
            obs, row = obs[row], jnp.arange(len(row))
        else:
            one_hot = jax.nn.one_hot(row, len(obs))
            spread = partial(jnp.einsum, "nr,r...->n...", one_hot, precision=jax.lax.Precision.HIGHEST)
        mask, distribution = slot_mask(obs), self.distribution(params, obs)
        log_prob = self.head.log_prob(spread(distribution), batch.raw_action, mask[row])
        return log_prob, spread(self.head.entropy(distribution, mask)), spread(self.value(params, obs))

    def gradient_step(
        self,
        loss: Callable[[Params, jax.Array, Batch], tuple[jax.Array, Metrics]],
        obs: jax.Array,
        carry: Carry,
        minibatch: Minibatch,
    ) -> tuple[Carry, Metrics]:
        """One gradient step on the loss of a minibatch; what `loss` reports, and the gradient's norm."""
        params, opt_state = carry
        seen = obs if minibatch.obs_rows is None else obs[minibatch.obs_rows]
        gradient, metrics = jax.grad(loss, has_aux=True)(params, seen, minibatch.decisions)
        metrics["grad_norm"] = global_norm(gradient)
        return descend(self.optimizer, gradient, params, opt_state), metrics

    def minibatches(self, batch: Batch, key: jax.Array, num_scenes: int) -> Minibatch:
        """One pass: (minibatches, N / minibatches, ...) decisions in random order, active ones first, or by scenes."""
        count = batch.weight.shape[0]
        if self.settings.minibatch_of == "scenes":
            scenes = jax.random.permutation(key, num_scenes).reshape(self.settings.minibatches, -1)
            of_scene = jnp.arange(count).reshape(num_scenes, -1)[scenes]  # (minibatches, scenes, episodes)
            parts = of_scene.reshape(self.settings.minibatches, -1)
            row = jnp.repeat(jnp.arange(scenes.shape[1], dtype=jnp.int32), of_scene.shape[2])
            decisions = jax.tree.map(lambda leaf: leaf[parts], batch)
            return Minibatch(decisions._replace(row=jnp.broadcast_to(row, parts.shape)), scenes)
        samples = min(self.settings.samples_per_update or count, count)
        if samples == count:
            order = jax.random.permutation(key, count)
        else:
            order = active_first(key, batch.weight)[:samples]
            order = jax.random.permutation(jax.random.fold_in(key, 1), order)  # inactive ones fall anywhere
        parts = order.reshape(self.settings.minibatches, -1)
        return Minibatch(jax.tree.map(lambda leaf: leaf[parts], batch))


def _same(values: jax.Array) -> jax.Array:
    return values

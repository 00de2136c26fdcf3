"""Action heads: distributions over plans, one independent factor for each slot.

Both heads act in the official box [0, 1]^6, where a block goes at 15 a seconds. What is sampled is
called a *choice*; the learner keeps choices, the environment gets the actions made of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import jax
import jax.numpy as jnp

from iphyre_jax.plans import DECISIONS_PER_SECOND, TIME_LIMIT
from iphyre_jax.train.config import HeadName

SLOTS = int(TIME_LIMIT * DECISIONS_PER_SECOND)  # 0 "never", then 0.1, 0.2, ..., 14.9 s


class ActionHead(Protocol):
    """What the learner asks of a head. Arrays: outputs (..., K) of the network, choices (...)."""

    @property
    def outputs(self) -> int:
        """Numbers the network must give for each slot, K."""

    def sample(self, key: jax.Array, outputs: jax.Array) -> jax.Array:
        """Draw a choice for each slot."""

    def mode(self, outputs: jax.Array) -> jax.Array:
        """The most probable choice of each slot."""

    def log_prob(self, outputs: jax.Array, choice: jax.Array) -> jax.Array:
        """Natural logarithm of the probability (density) of each slot's choice."""

    def entropy(self, outputs: jax.Array) -> jax.Array:
        """Entropy of each slot, nats."""

    def action(self, choice: jax.Array) -> jax.Array:
        """float32 in [0, 1]: the official action of each choice."""


@dataclass(frozen=True)
class SlotHead:
    """Categorical over the 150 instants at which the in-advance environment looks: choice k means 0.1 k s, 0 never.

    The network's outputs are added to the logarithm of a prior, `never` for staying and an
    exponential in time with mean `scale` s for the instants: most useful times are early.
    """

    never: float = 0.25
    scale: float = 4.0

    outputs: ClassVar[int] = SLOTS

    def _log_prior(self) -> jax.Array:
        """(150,) float32 natural logarithm of the prior."""
        seconds = jnp.arange(1, SLOTS, dtype=jnp.float32) / DECISIONS_PER_SECOND
        instants = math.log1p(-self.never) + jax.nn.log_softmax(-seconds / self.scale)
        return jnp.concatenate([jnp.full((1,), math.log(self.never), jnp.float32), instants])

    def _log_probabilities(self, outputs: jax.Array) -> jax.Array:
        """(..., 150) normalised log probabilities."""
        prior = jnp.broadcast_to(self._log_prior(), outputs.shape)
        return jax.nn.log_softmax(outputs + prior, axis=-1)

    def sample(self, key: jax.Array, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`; int32 choices."""
        return jax.random.categorical(key, self._log_probabilities(outputs), axis=-1).astype(jnp.int32)

    def mode(self, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        return self._log_probabilities(outputs).argmax(axis=-1).astype(jnp.int32)

    def log_prob(self, outputs: jax.Array, choice: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        log_probabilities = self._log_probabilities(outputs)
        return jnp.take_along_axis(log_probabilities, choice[..., None], axis=-1)[..., 0]

    def entropy(self, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        log_probabilities = self._log_probabilities(outputs)
        return -(jnp.exp(log_probabilities) * log_probabilities).sum(axis=-1)

    def action(self, choice: jax.Array) -> jax.Array:
        """See `ActionHead`; k / 150, which the environment rounds back to instant k."""
        return choice.astype(jnp.float32) / SLOTS


@dataclass(frozen=True)
class GaussianHead:
    """Normal with its own spread for each slot; the choice u becomes the action (u + 1) / 2, clipped to the box.

    At first mean 0 and deviation 1, as the paper's agents begin: times of 7.5 +- 7.5 s, with a
    sixth of the mass on either edge, where the block stays.
    """

    outputs: ClassVar[int] = 2

    @staticmethod
    def _mean_and_log_std(outputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(...) each; the spread is kept between e^-5 and e^1."""
        return outputs[..., 0], jnp.clip(outputs[..., 1], -5.0, 1.0)

    def sample(self, key: jax.Array, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`; float32 choices, not clipped."""
        mean, log_std = self._mean_and_log_std(outputs)
        return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)

    def mode(self, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        return self._mean_and_log_std(outputs)[0]

    def log_prob(self, outputs: jax.Array, choice: jax.Array) -> jax.Array:
        """See `ActionHead`; of the unclipped choice."""
        mean, log_std = self._mean_and_log_std(outputs)
        return -0.5 * jnp.square((choice - mean) * jnp.exp(-log_std)) - log_std - 0.5 * math.log(2 * math.pi)

    def entropy(self, outputs: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        return self._mean_and_log_std(outputs)[1] + 0.5 * math.log(2 * math.pi * math.e)

    def action(self, choice: jax.Array) -> jax.Array:
        """See `ActionHead`."""
        return jnp.clip((choice + 1.0) / 2.0, 0.0, 1.0)


def action_head(name: HeadName) -> ActionHead:
    """The head that a configuration names."""
    heads: dict[HeadName, ActionHead] = {"slots": SlotHead(), "gaussian": GaussianHead()}
    return heads[name]

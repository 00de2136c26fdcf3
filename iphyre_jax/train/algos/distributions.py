"""Action heads: what a network's outputs mean, as distributions over decisions.

What is sampled is called a *choice*; the learner keeps choices, the environment gets the actions made of them. In
advance and combined, a decision is a time for each slot: one factor a slot, in the official box [0, 1]^6, where a block
goes at 15 a seconds. On the fly it is one of seven. Slots that stand for no block (`mask` False) never count.

Shapes: outputs (..., *shape), choices (..., 6) or (...), masks (..., 6) bool.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Final, Literal, Protocol

import jax
import jax.numpy as jnp

from iphyre_jax.rules import DECISIONS_PER_SECOND, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE

HeadName = Literal["slots", "gaussian", "squashed", "point", "categorical", "even"]

SLOTS = int(TIME_LIMIT * DECISIONS_PER_SECOND)  # 0 "never", then 0.1, 0.2, ..., 14.9 s


class Head(Protocol):
    """What the learner asks of a head."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Outputs that the network must give for a decision."""

    def sample(self, key: jax.Array, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """Draw choices."""

    def mode(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """The most probable choices."""

    def log_prob(self, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
        """(...) natural logarithm of the probability (density) of choices."""

    def entropy(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """(...) nats, per slot that stands for a block, or of the whole decision on the fly."""

    def action(self, choice: jax.Array) -> jax.Array:
        """The environment's actions for choices."""


def _sum(each: jax.Array, mask: jax.Array) -> jax.Array:
    """(...) sum over the slots that stand for a block."""
    return jnp.where(mask, each, jnp.zeros_like(each)).sum(axis=-1)


def _mean(each: jax.Array, mask: jax.Array) -> jax.Array:
    """(...) mean over the slots that stand for a block."""
    return _sum(each, mask) / jnp.maximum(mask.sum(axis=-1), 1)


def _pick(log_probabilities: jax.Array, choice: jax.Array) -> jax.Array:
    """The entry of the last axis that was chosen."""
    return jnp.take_along_axis(log_probabilities, choice[..., None], axis=-1)[..., 0]


def _nats(log_probabilities: jax.Array) -> jax.Array:
    """Entropy of categorical distributions on the last axis; one of probability 0 adds nothing."""
    return -(jnp.exp(log_probabilities) * jnp.maximum(log_probabilities, -1e3)).sum(axis=-1)


@dataclass(frozen=True)
class SlotHead:
    """Categorical over the 150 instants at which the in-advance environment looks: choice k means 0.1 k s, 0 never.

    Only one block goes at an instant and the environment forgets the others that were to go then; a policy that gives
    like blocks the same time means all of them. So each goes at the first instant from its own on that no earlier slot
    has.

    The network's outputs are added to the logarithm of a prior, `never` for staying and an
    exponential in time with mean `scale` s for the instants: most useful times are early.
    """

    never: float = 0.25
    scale: float = 4.0

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, SLOTS)

    def _log_prior(self) -> jax.Array:
        """(150,) float32 natural logarithm of the prior."""
        seconds = jnp.arange(1, SLOTS, dtype=jnp.float32) / DECISIONS_PER_SECOND
        instants = math.log1p(-self.never) + jax.nn.log_softmax(-seconds / self.scale)
        return jnp.concatenate([jnp.full((1,), math.log(self.never), jnp.float32), instants])

    def _log_probabilities(self, outputs: jax.Array) -> jax.Array:
        """(..., 6, 150) normalised log probabilities."""
        prior = jnp.broadcast_to(self._log_prior(), outputs.shape)
        return jax.nn.log_softmax(outputs + prior, axis=-1)

    def sample(self, key: jax.Array, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; int32 choices."""
        del mask
        return jax.random.categorical(key, self._log_probabilities(outputs), axis=-1).astype(jnp.int32)

    def mode(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        del mask
        return self._log_probabilities(outputs).argmax(axis=-1).astype(jnp.int32)

    def log_prob(self, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _sum(_pick(self._log_probabilities(outputs), choice), mask)

    def entropy(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _mean(_nats(self._log_probabilities(outputs)), mask)

    def action(self, choice: jax.Array) -> jax.Array:
        """See `Head`; k / 150, which the environment rounds back to instant k."""
        return one_after_the_other(choice).astype(jnp.float32) / SLOTS


def one_after_the_other(choice: jax.Array) -> jax.Array:
    """(..., 6) instants -> the same, each put off until no earlier slot has it; 0, never, stays, 150 is never too."""
    instants: list[jax.Array] = []
    for each in jnp.moveaxis(choice, -1, 0):
        for _ in instants:  # as often as it may meet an earlier one
            taken = jnp.stack([each == other for other in instants]).any(axis=0)
            each = each + (taken & (each > 0))
        instants.append(each)
    return jnp.stack(instants, axis=-1)


def _normal_log_prob(mean: jax.Array, log_std: jax.Array, value: jax.Array) -> jax.Array:
    """Natural logarithm of normal densities."""
    return -0.5 * jnp.square((value - mean) * jnp.exp(-log_std)) - log_std - 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class GaussianHead:
    """Normal with its own spread for each slot; the choice u becomes the action (u + 1) / 2, clipped to the box.

    At first mean 0 and deviation 1, as the paper's agents begin: times of 7.5 +- 7.5 s, with a
    sixth of the mass on either edge, where the block stays.
    """

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, 2)

    @staticmethod
    def _mean_and_log_std(outputs: jax.Array) -> tuple[jax.Array, jax.Array]:
        """(..., 6) each; the spread is kept between e^-5 and e^1."""
        return outputs[..., 0], jnp.clip(outputs[..., 1], -5.0, 1.0)

    def sample(self, key: jax.Array, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; float32 choices, not clipped."""
        del mask
        mean, log_std = self._mean_and_log_std(outputs)
        return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)

    def mode(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        del mask
        return self._mean_and_log_std(outputs)[0]

    def log_prob(self, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; of the unclipped choice."""
        return _sum(_normal_log_prob(*self._mean_and_log_std(outputs), choice), mask)

    def entropy(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _mean(self._mean_and_log_std(outputs)[1] + 0.5 * math.log(2 * math.pi * math.e), mask)

    def action(self, choice: jax.Array) -> jax.Array:
        """See `Head`."""
        return jnp.clip((choice + 1.0) / 2.0, 0.0, 1.0)


@dataclass(frozen=True)
class SquashedHead(GaussianHead):
    """Normal pressed into the box: the choice u becomes (tanh u + 1) / 2, and densities are those of tanh u."""

    def log_prob(self, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; log N(u) - log(1 - tanh^2 u), the latter as 2 (log 2 - u - softplus(-2 u))."""
        slope = 2.0 * (math.log(2.0) - choice - jax.nn.softplus(-2.0 * choice))
        return _sum(_normal_log_prob(*self._mean_and_log_std(outputs), choice) - slope, mask)

    def entropy(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """No formula: minus the log density at the mode, per slot. SAC estimates it from samples instead."""
        return -self.log_prob(outputs, self.mode(outputs, mask), mask) / jnp.maximum(mask.sum(axis=-1), 1)

    def action(self, choice: jax.Array) -> jax.Array:
        """See `Head`."""
        return (jnp.tanh(choice) + 1.0) / 2.0


@dataclass(frozen=True)
class PointHead:
    """One time for each slot, without chance: the output u becomes the action (tanh u + 1) / 2."""

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, 1)

    def mode(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """The only choices there are."""
        del mask
        return outputs[..., 0]

    def action(self, choice: jax.Array) -> jax.Array:
        """See `Head`."""
        return (jnp.tanh(choice) + 1.0) / 2.0


@dataclass(frozen=True)
class CategoricalHead:
    """One of seven: 0 does nothing, i removes the block of slot i - 1; slots without a block cannot be chosen.

    The outputs are added to the logarithm of a prior: `idle` for doing nothing, the rest shared by the blocks. A
    decision comes every 0.1 s, so without it all blocks would be gone within the first second.
    """

    idle: float = 0.97

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE + 1,)

    def log_probabilities(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """(..., 7) normalised log probabilities, -inf for slots without a block."""
        share = jnp.log((1.0 - self.idle) / jnp.maximum(mask.sum(axis=-1, keepdims=True), 1))
        blocks = jnp.where(mask, jnp.broadcast_to(share, mask.shape), -jnp.inf)
        prior = jnp.concatenate([jnp.full_like(share, math.log(self.idle)), blocks], axis=-1)
        return jax.nn.log_softmax(outputs + prior, axis=-1)

    def sample(self, key: jax.Array, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; int32 choices."""
        return jax.random.categorical(key, self.log_probabilities(outputs, mask), axis=-1).astype(jnp.int32)

    def mode(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return self.log_probabilities(outputs, mask).argmax(axis=-1).astype(jnp.int32)

    def log_prob(self, outputs: jax.Array, choice: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _pick(self.log_probabilities(outputs, mask), choice)

    def entropy(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _nats(self.log_probabilities(outputs, mask))

    def action(self, choice: jax.Array) -> jax.Array:
        """See `Head`."""
        return choice


HEADS: Final[Mapping[HeadName, Head | PointHead]] = MappingProxyType(
    {
        "slots": SlotHead(),
        "gaussian": GaussianHead(),
        "squashed": SquashedHead(),
        "point": PointHead(),
        "categorical": CategoricalHead(),
        "even": CategoricalHead(idle=1 / 7),
    }
)


def action_head(name: HeadName) -> Head:
    """The head, one that can be sampled from, that a configuration names."""
    head = HEADS[name]
    if isinstance(head, PointHead):
        raise ValueError(f"head: expected one to sample from, got {name!r}")
    return head

"""Action heads: distributions over actions, from a network's outputs.

A head samples *raw actions*, which the learner keeps, and turns them into the environment's actions. In advance and
combined, an action is a time for each slot, in the official box [0, 1]^6: action a removes a block at 15 a seconds. On
the fly an action is one of seven. Slots that stand for no block (`mask` False) never count.

Shapes: outputs and distributions (..., *shape), raw actions (..., 6) or (...), masks (..., 6) bool.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Final, Protocol

import jax
import jax.numpy as jnp

from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES
from iphyre_jax.scenes import MAX_ELIMINABLE
from iphyre_jax.train.settings.agents import HeadName


class Head(Protocol):
    """A distribution over actions."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the network's outputs for a decision."""

    def distribution(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """The distributions of outputs: log probabilities, or mean and log deviation."""

    def sample(self, key: jax.Array, distribution: jax.Array) -> jax.Array:
        """Draw raw actions."""

    def mode(self, distribution: jax.Array) -> jax.Array:
        """The most probable raw actions."""

    def log_prob(self, distribution: jax.Array, raw_action: jax.Array, mask: jax.Array) -> jax.Array:
        """(...) natural logarithm of the probability (density) of raw actions."""

    def entropy(self, distribution: jax.Array, mask: jax.Array) -> jax.Array:
        """(...) nats: per slot that stands for a block, or, on the fly, of the action."""

    def action(self, raw_action: jax.Array) -> jax.Array:
        """The environment's actions for raw actions."""


def _sum(per_slot: jax.Array, mask: jax.Array) -> jax.Array:
    """(...) sum over the slots that stand for a block."""
    return jnp.where(mask, per_slot, jnp.zeros_like(per_slot)).sum(axis=-1)


def _mean(per_slot: jax.Array, mask: jax.Array) -> jax.Array:
    """(...) mean over the slots that stand for a block."""
    return _sum(per_slot, mask) / jnp.maximum(mask.sum(axis=-1), 1)


def _taken(log_probabilities: jax.Array, raw_action: jax.Array) -> jax.Array:
    """The log-probability of the action taken."""
    return jnp.take_along_axis(log_probabilities, raw_action[..., None], axis=-1)[..., 0]


def _categorical_entropy(log_probabilities: jax.Array) -> jax.Array:
    """Entropy of categorical distributions on the last axis; one of probability 0 adds nothing."""
    return -(jnp.exp(log_probabilities) * jnp.maximum(log_probabilities, -1e3)).sum(axis=-1)


@dataclass(frozen=True)
class TimeGridHead:
    """Categorical over the 150 instants at which the in-advance environment acts: raw action k means 0.1 k s, 0 never.

    The environment removes one block at an instant and forgets others of the same instant. A policy that gives similar
    blocks the same time means all of them, so each block moves to the next instant that no earlier slot has.

    The network's outputs are added to the logarithm of a prior: `never` for staying and an exponential in time with
    mean `scale` s for the instants, since most useful times are early.
    """

    never: float = 0.25
    scale: float = 4.0

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, FRAMES)  # 0 "never", then 0.1, 0.2, ..., 14.9 s

    def _log_prior(self) -> jax.Array:
        """(150,) float32 natural logarithm of the prior."""
        seconds = jnp.arange(1, FRAMES, dtype=jnp.float32) / DECISIONS_PER_SECOND
        instants = math.log1p(-self.never) + jax.nn.log_softmax(-seconds / self.scale)
        return jnp.concatenate([jnp.full((1,), math.log(self.never), jnp.float32), instants])

    def distribution(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; (..., 6, 150) normalised log probabilities."""
        del mask
        prior = jnp.broadcast_to(self._log_prior(), outputs.shape)
        return jax.nn.log_softmax(outputs + prior, axis=-1)

    def sample(self, key: jax.Array, distribution: jax.Array) -> jax.Array:
        """See `Head`; int32."""
        return jax.random.categorical(key, distribution, axis=-1).astype(jnp.int32)

    def mode(self, distribution: jax.Array) -> jax.Array:
        """See `Head`."""
        return distribution.argmax(axis=-1).astype(jnp.int32)

    def log_prob(self, distribution: jax.Array, raw_action: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _sum(_taken(distribution, raw_action), mask)

    def entropy(self, distribution: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _mean(_categorical_entropy(distribution), mask)

    def action(self, raw_action: jax.Array) -> jax.Array:
        """See `Head`; k / 150, which the environment rounds back to instant k."""
        return distinct_instants(raw_action).astype(jnp.float32) / FRAMES


def distinct_instants(raw_action: jax.Array) -> jax.Array:
    """(..., 6) instants, each delayed until no earlier slot has it; 0 is never and stays, 150 is never too."""
    instants: list[jax.Array] = []
    for instant in jnp.moveaxis(raw_action, -1, 0):
        for _ in instants:  # it can meet each earlier one once
            taken = jnp.stack([instant == other for other in instants]).any(axis=0)
            instant = instant + (taken & (instant > 0))
        instants.append(instant)
    return jnp.minimum(jnp.stack(instants, axis=-1), FRAMES)  # a third slot at the end would have 151


def _normal_log_prob(distribution: jax.Array, value: jax.Array) -> jax.Array:
    """Natural logarithm of normal densities; distribution (..., 2): mean and log deviation."""
    mean, log_std = distribution[..., 0], distribution[..., 1]
    return -0.5 * jnp.square((value - mean) * jnp.exp(-log_std)) - log_std - 0.5 * math.log(2 * math.pi)


@dataclass(frozen=True)
class GaussianHead:
    """Normal with its own deviation for each slot; the raw action u becomes (u + 1) / 2, clipped to the box.

    It starts with mean 0 and deviation 1, like the paper's agents: times of 7.5 +- 7.5 s, with a sixth of the mass on
    either edge, where the block stays.
    """

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, 2)

    def distribution(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; (..., 6, 2) mean and log deviation, the latter between -5 and 1."""
        del mask
        return jnp.stack([outputs[..., 0], jnp.clip(outputs[..., 1], -5.0, 1.0)], axis=-1)

    def sample(self, key: jax.Array, distribution: jax.Array) -> jax.Array:
        """See `Head`; float32, not clipped."""
        mean, log_std = distribution[..., 0], distribution[..., 1]
        return mean + jnp.exp(log_std) * jax.random.normal(key, mean.shape, mean.dtype)

    def mode(self, distribution: jax.Array) -> jax.Array:
        """See `Head`."""
        return distribution[..., 0]

    def log_prob(self, distribution: jax.Array, raw_action: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; of the unclipped raw action."""
        return _sum(_normal_log_prob(distribution, raw_action), mask)

    def entropy(self, distribution: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        return _mean(distribution[..., 1] + 0.5 * math.log(2 * math.pi * math.e), mask)

    def action(self, raw_action: jax.Array) -> jax.Array:
        """See `Head`."""
        return jnp.clip((raw_action + 1.0) / 2.0, 0.0, 1.0)


@dataclass(frozen=True)
class TanhNormalHead(GaussianHead):
    """Normal squashed into the box: the raw action u becomes (tanh u + 1) / 2, and densities are those of tanh u."""

    def log_prob(self, distribution: jax.Array, raw_action: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; log N(u) - log(1 - tanh^2 u), the latter as 2 (log 2 - u - softplus(-2 u))."""
        slope = 2.0 * (math.log(2.0) - raw_action - jax.nn.softplus(-2.0 * raw_action))
        return _sum(_normal_log_prob(distribution, raw_action) - slope, mask)

    def entropy(self, distribution: jax.Array, mask: jax.Array) -> jax.Array:
        """There is no formula: minus the log density at the mode, per slot. SAC estimates the entropy from samples."""
        return -self.log_prob(distribution, self.mode(distribution), mask) / jnp.maximum(mask.sum(axis=-1), 1)

    def action(self, raw_action: jax.Array) -> jax.Array:
        """See `Head`."""
        return (jnp.tanh(raw_action) + 1.0) / 2.0


@dataclass(frozen=True)
class DeterministicHead:
    """One time for each slot: the output u becomes the action (tanh u + 1) / 2. It cannot be sampled."""

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE, 1)

    def mode(self, outputs: jax.Array) -> jax.Array:
        """The only raw actions."""
        return outputs[..., 0]

    def action(self, raw_action: jax.Array) -> jax.Array:
        """See `Head`."""
        return (jnp.tanh(raw_action) + 1.0) / 2.0


@dataclass(frozen=True)
class CategoricalHead:
    """One of seven: 0 does nothing, i removes the block of slot i - 1.

    The outputs are added to the logarithm of a prior: `no_op_prob` for doing nothing; the slots share the rest. A
    decision comes every 0.1 s, so without the prior all blocks would be gone within the first second.
    """

    no_op_prob: float = 0.97
    empty_slots: bool = False
    """Whether slots without a block share it too and can be chosen, which does nothing. Else their probability is 0."""

    shape: ClassVar[tuple[int, ...]] = (MAX_ELIMINABLE + 1,)

    def distribution(self, outputs: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`; (..., 7) normalised log probabilities, -inf for actions that are not offered."""
        slots = self.offered(mask)[..., 1:]
        share = jnp.log((1.0 - self.no_op_prob) / jnp.maximum(slots.sum(axis=-1, keepdims=True), 1))
        blocks = jnp.where(slots, jnp.broadcast_to(share, slots.shape), -jnp.inf)
        prior = jnp.concatenate([jnp.full_like(share, math.log(self.no_op_prob)), blocks], axis=-1)
        return jax.nn.log_softmax(outputs + prior, axis=-1)

    def offered(self, mask: jax.Array) -> jax.Array:
        """(..., 7) bool: the actions that can be chosen, where (..., 6) slots have a block."""
        slots = jnp.ones_like(mask) if self.empty_slots else mask
        return jnp.concatenate([jnp.ones((*mask.shape[:-1], 1), bool), slots], axis=-1)

    def sample(self, key: jax.Array, distribution: jax.Array) -> jax.Array:
        """See `Head`; int32."""
        return jax.random.categorical(key, distribution, axis=-1).astype(jnp.int32)

    def mode(self, distribution: jax.Array) -> jax.Array:
        """See `Head`."""
        return distribution.argmax(axis=-1).astype(jnp.int32)

    def log_prob(self, distribution: jax.Array, raw_action: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        del mask  # its slots have probability 0
        return _taken(distribution, raw_action)

    def entropy(self, distribution: jax.Array, mask: jax.Array) -> jax.Array:
        """See `Head`."""
        del mask
        return _categorical_entropy(distribution)

    def action(self, raw_action: jax.Array) -> jax.Array:
        """See `Head`."""
        return raw_action


HEADS: Final[Mapping[HeadName, Head | DeterministicHead]] = MappingProxyType(
    {
        "time_grid": TimeGridHead(),
        "gaussian": GaussianHead(),
        "tanh_normal": TanhNormalHead(),
        "deterministic": DeterministicHead(),
        "categorical": CategoricalHead(),
        "uniform": CategoricalHead(no_op_prob=1 / 7, empty_slots=True),
    }
)


def action_head(name: HeadName) -> Head:
    """The head of a name, if it can be sampled."""
    head = HEADS[name]
    if isinstance(head, DeterministicHead):
        raise ValueError(f"head: expected one that can be sampled, got {name!r}")
    return head

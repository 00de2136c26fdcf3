"""The settings of each algorithm, field by field. Presets fill them in (`presets.py`).

A field's metadata says which numbers it takes: at least "least" (0 by default), above 0 if "positive", at most "most".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal

AgentName = Literal["ppo", "a2c", "sac", "ddpg", "dqn", "random"]
HeadName = Literal["time_grid", "gaussian", "tanh_normal", "deterministic", "categorical", "uniform"]
AdvantageScope = Literal["scene", "batch", "none"]
MinibatchOf = Literal["decisions", "scenes"]

ATTENTION_HEADS: Final = 4  # of networks that attend from object to object

_AT_LEAST_1: Final = MappingProxyType({"least": 1})
_POSITIVE: Final = MappingProxyType({"positive": True})
_SHARE: Final = MappingProxyType({"most": 1})
_SIGNED: Final = MappingProxyType({"least": -1e9})


def _count(default: int) -> Any:  # noqa: ANN401 - as `dataclasses.field`
    """A whole number, at least 1."""
    return field(default=default, metadata=_AT_LEAST_1)


def _positive(default: float) -> Any:  # noqa: ANN401 - as `dataclasses.field`
    """A number above 0."""
    return field(default=default, metadata=_POSITIVE)


def _share(default: float) -> Any:  # noqa: ANN401 - as `dataclasses.field`
    """A number from 0 to 1."""
    return field(default=default, metadata=_SHARE)


@dataclass(frozen=True)
class PolicyGradient:
    """What PPO and A2C have in common."""

    learning_rate: float = _positive(1e-3)
    """Adam's learning rate at the start."""
    anneal_lr: bool = True
    """Let the learning rate and `ent_coef` fall linearly to 0 over the run."""
    max_grad_norm: float = _positive(1.0)
    """Largest global norm of a gradient; longer ones are scaled down."""
    minibatches: int = _count(4)
    """Gradient steps in each pass over the decisions. Must divide their number, or that of the scenes."""
    minibatch_of: MinibatchOf = "decisions"
    """What a minibatch is made of: decisions, drawn from all scenes; or whole scenes (in advance only), which costs
    less, since the networks see each scene once in a pass."""
    samples_per_update: int = 0
    """Decisions of an update to learn from, drawn anew for each pass; 0 for all."""
    ent_coef: float = 0.01
    """Weight of the entropy bonus (nats per block)."""
    critic: bool = False
    """Train a value network as the baseline. Without one, the mean of a scene's episodes is the baseline, and a reward
    k decisions later counts (gamma gae_lambda)^k, since there are no values to take its place."""
    vf_coef: float = 0.5
    """Weight of the value loss."""
    gamma: float = _share(1.0)
    """Discount of a reward one decision later."""
    gae_lambda: float = _share(0.95)
    """Lambda of generalised advantage estimation."""
    normalize_advantage: AdvantageScope = "scene"
    """Subtract the mean of the advantages and divide by their standard deviation: within the episodes of each scene,
    within the whole batch, or not at all."""
    std_floor: float = _positive(30.0)
    """Points of reward added to that standard deviation. It keeps scenes whose episodes differ by a few points from
    counting as much as scenes that are sometimes solved."""


@dataclass(frozen=True)
class PPO(PolicyGradient):
    """Proximal policy optimisation."""

    epochs: int = _count(4)
    """Passes over the decisions of an update."""
    clip_eps: float = _positive(0.2)
    """How far the probability ratio may leave 1 before its gradient stops."""
    value_clip: float = 0.0
    """Largest squared value error that counts, in units of (1000 points) squared; 0 for no limit."""
    kl_coef: float = 0.0
    """Weight at the start of the KL divergence from the policy before the update; 0 for none."""
    kl_target: float = 0.01
    """The weight grows by half above twice this divergence (nats) and is halved below half of it: of the update's last
    pass, where the column `kl` of metrics.csv is the mean of all passes."""


@dataclass(frozen=True)
class A2C(PolicyGradient):
    """Advantage actor-critic: the plain policy gradient, each decision used once."""

    max_grad_norm: float = _positive(0.5)
    minibatches: int = _count(1)


@dataclass(frozen=True)
class OffPolicy:
    """What the algorithms that learn from a replay buffer have in common."""

    learning_rate: float = _positive(3e-4)
    """Adam's learning rate, of every network."""
    gamma: float = _share(1.0)
    """Discount of a reward one decision later."""
    n_step: int = _count(1)
    """Decisions whose rewards are summed before the value network takes over."""
    buffer_size: int = _count(100_000)
    """Decisions kept; the oldest go first. At least those of an update."""
    samples_per_update: int = 0
    """Decisions of an update to keep, drawn at random; 0 for all."""
    batch_size: int = _count(256)
    """Decisions in a gradient step."""
    gradient_steps: int = _count(64)
    """Gradient steps in an update."""
    warmup: int = 1000
    """Decisions that must be kept before learning begins."""
    tau: float = _share(0.005)
    """Share of the way that target networks move to the learned ones in a gradient step."""

    def rows(self, decisions: int) -> int:
        """Transitions that an update of so many decisions keeps, at most."""
        return min(self.samples_per_update or decisions, decisions)

    def capacity(self, decisions: int) -> int:
        """Transitions that the buffer keeps."""
        return max(self.buffer_size, self.rows(decisions))


@dataclass(frozen=True)
class SAC(OffPolicy):
    """Soft actor-critic: continuous over times, discrete on the fly."""

    target_entropy: float = field(default=-1.0, metadata=_SIGNED)
    """Entropy to hold, nats: for each block where times are continuous, else for a decision."""
    alpha: float = _positive(0.1)
    """Weight of the entropy at the start, in units of 1000 points."""


@dataclass(frozen=True)
class DDPG(OffPolicy):
    """Deep deterministic policy gradient, with noise added to its actions."""

    noise: float = 0.3
    """Standard deviation of the noise at the start, as a share of the 15 s."""
    noise_end: float = 0.02
    """The same at the end of `noise_updates`."""
    noise_updates: int = _count(100)
    """Updates over which the noise falls linearly."""
    random_updates: int = 2
    """Updates with uniformly random actions at the start."""
    actor_lr: float = _positive(3e-4)
    """Adam's learning rate of the actor."""


@dataclass(frozen=True)
class DQN(OffPolicy):
    """Deep Q-network: greedy, but for a share of random actions."""

    epsilon: float = _share(1.0)
    """Share of random actions at the start."""
    epsilon_end: float = _share(0.02)
    """The same at the end of `epsilon_updates`."""
    epsilon_updates: int = _count(50)
    """Updates over which the share falls linearly."""
    no_op_prob: float = 1 / 7
    """Probability that a random action removes nothing; the blocks share the rest equally."""
    double: bool = True
    """Choose the next action by the learned network, not by the target network."""
    dueling: bool = True
    """Compute value and advantages as two streams."""


@dataclass(frozen=True)
class Random:
    """Uniform over the actions; learns nothing."""


Settings = PPO | A2C | SAC | DDPG | DQN | Random

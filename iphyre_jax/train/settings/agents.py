"""What each algorithm can be told, field by field. Presets fill these in (`presets.py`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, Literal

AgentName = Literal["ppo", "a2c", "sac", "ddpg", "dqn", "random"]
Normalise = Literal["scene", "batch", "none"]


@dataclass(frozen=True)
class PolicyGradient:
    """What PPO and A2C have in common."""

    learning_rate: float = 1e-3
    """Adam's learning rate at the start."""
    anneal: bool = True
    """Learning rate and entropy weight fall linearly to 0 over the run."""
    max_grad_norm: float = 1.0
    """Gradients are scaled down to at most this global norm."""
    minibatches: int = 4
    """Gradient steps in each pass over a round; must divide the number of decisions that are learned from."""
    rows: int = 0
    """Decisions of a round that are learned from, drawn anew for each pass; 0 for all."""
    entropy: float = 0.01
    """Weight of the entropy bonus (nats per block)."""
    critic: bool = False
    """Train a value network as the baseline. Without one the value is 0 and a round's own returns are the baseline."""
    value_weight: float = 0.5
    """Weight of the value loss."""
    discount: float = 1.0
    """What a reward one decision later counts."""
    trace: float = 0.95
    """Lambda of generalised advantage estimation."""
    normalise: Normalise = "scene"
    """Advantages less their mean, divided by their standard deviation: within the episodes of one scene, or within the
    whole batch, or not at all."""
    std_floor: float = 30.0
    """Points of reward added to the standard deviation, so that a scene whose episodes differ by a few points does not
    count as much as one that some solve."""


@dataclass(frozen=True)
class PPO(PolicyGradient):
    """Proximal policy optimisation."""

    epochs: int = 4
    """Passes over a round."""
    clip: float = 0.2
    """How far the probability ratio may leave 1 before its gradient stops."""
    value_clip: float = 0.0
    """Squared value errors count up to this, in points squared over 1000 squared; 0 for no limit."""
    kl_weight: float = 0.0
    """Weight of the divergence from the policy before the round, at the start; 0 for none."""
    kl_target: float = 0.01
    """The weight is doubled or halved, by halves, to keep the divergence near this (nats)."""


@dataclass(frozen=True)
class A2C(PolicyGradient):
    """Advantage actor-critic: the plain policy gradient, each decision used once."""

    max_grad_norm: float = 0.5
    minibatches: int = 1


@dataclass(frozen=True)
class OffPolicy:
    """What the algorithms that learn from a replay buffer have in common."""

    learning_rate: float = 3e-4
    """Adam's learning rate, of every network."""
    discount: float = 1.0
    """What a reward one decision later counts."""
    n_step: int = 1
    """Decisions whose rewards are summed before the value of what follows is taken from the network."""
    replay: int = 100_000
    """Transitions kept; the oldest go first."""
    rows: int = 0
    """Decisions of a round that are kept, drawn by chance; 0 for all."""
    batch: int = 256
    """Transitions in a gradient step."""
    steps: int = 64
    """Gradient steps in a round."""
    warmup: int = 1000
    """Transitions that must be kept before learning begins."""
    target_rate: float = 0.005
    """Share of the way that target networks move to the learned ones in a gradient step."""


@dataclass(frozen=True)
class SAC(OffPolicy):
    """Soft actor-critic: continuous over times, discrete on the fly."""

    target_entropy: float = -1.0
    """Nats that the entropy is held at: for each block where times are continuous, else for a decision."""
    alpha: float = 0.1
    """Weight of the entropy at the start; one point of reward is 0.001."""


@dataclass(frozen=True)
class DDPG(OffPolicy):
    """Deep deterministic policy gradient, with noise added to its actions."""

    noise: float = 0.3
    """Standard deviation of the noise at the start, as a share of the 15 s."""
    noise_end: float = 0.02
    """The same at the end of `noise_rounds`."""
    noise_rounds: int = 100
    """Rounds over which the noise falls linearly."""
    random_rounds: int = 2
    """Rounds of uniformly random actions at the start."""
    actor_rate: float = 3e-4
    """Adam's learning rate of the actor."""


@dataclass(frozen=True)
class DQN(OffPolicy):
    """Deep Q-network: greedy but for a share of random actions."""

    epsilon: float = 1.0
    """Share of random actions at the start."""
    epsilon_end: float = 0.02
    """The same at the end of `epsilon_rounds`."""
    epsilon_rounds: int = 50
    """Rounds over which it falls linearly."""
    idle: float = 1 / 7
    """Share of the random actions that remove nothing; the rest are shared equally by the blocks."""
    double: bool = True
    """Choose the next action by the learned network, not by the target."""
    dueling: bool = True
    """Value and advantages as two streams."""


@dataclass(frozen=True)
class Random:
    """Uniform over the actions; learns nothing."""


Settings = PPO | A2C | SAC | DDPG | DQN | Random

SETTINGS: Final[Mapping[AgentName, type[Settings]]] = MappingProxyType(
    {"ppo": PPO, "a2c": A2C, "sac": SAC, "ddpg": DDPG, "dqn": DQN, "random": Random}
)

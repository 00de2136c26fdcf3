"""The algorithms by name, and what the trainer asks of each of them: the functions of one module."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, Protocol

import jax

from iphyre_jax.train.algos import a2c, ddpg, dqn, ppo, random_agent, sac
from iphyre_jax.train.collect import Decision, Trajectory
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.settings.agents import AgentName
from iphyre_jax.train.settings.run import TrainConfig

State = Any  # a NamedTuple of the algorithm's own


class Algorithm(Protocol):
    """Pure functions of a static configuration; `learn` is one jitted update."""

    @property
    def METRICS(self) -> tuple[str, ...]:
        """Names of what `learn` reports."""

    def init(self, config: TrainConfig, key: jax.Array, observation: jax.Array) -> State:
        """The state before the first round; observations (S, D) of the training games give sizes and centre."""

    def act(self, config: TrainConfig, state: State, key: jax.Array, observation: jax.Array, each: int = 1) -> Decision:
        """So many decisions for each observation (B, D), one after the other, as episodes are played to learn from."""

    def greedy(self, config: TrainConfig, state: State, observation: jax.Array) -> jax.Array:
        """The action held for best for each observation (B, D)."""

    def acting(self, state: State) -> State:
        """The state with nothing left in it but what `act` and `greedy` look at."""

    def learn(
        self, config: TrainConfig, state: State, key: jax.Array, trajectory: Trajectory, scenes: int
    ) -> tuple[State, dict[str, jax.Array]]:
        """The state after learning from a round's episodes of so many scenes, and what to report."""


ALGORITHMS: Final[Mapping[AgentName, Algorithm]] = MappingProxyType(
    {"ppo": ppo, "a2c": a2c, "sac": sac, "ddpg": ddpg, "dqn": dqn, "random": random_agent}
)


def algorithm(config: TrainConfig) -> Algorithm:
    """The algorithm of a configuration."""
    return ALGORITHMS[config.agent]


def init(config: TrainConfig, key: jax.Array) -> State:
    """The state of a configuration's algorithm before the first round.

    Raises:
        ValueError: one line; a setting cannot work.
    """
    config.check()
    seen = start_observations(config.strategy, config.observation, config.training_games)
    return algorithm(config).init(config, key, seen)

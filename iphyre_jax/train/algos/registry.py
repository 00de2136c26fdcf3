"""The algorithm of each agent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, Final

import jax

from iphyre_jax.train.algos.a2c import A2CAlgorithm
from iphyre_jax.train.algos.base import Algorithm, State
from iphyre_jax.train.algos.ddpg import DDPGAlgorithm
from iphyre_jax.train.algos.dqn import DQNAlgorithm
from iphyre_jax.train.algos.ppo import PPOAlgorithm
from iphyre_jax.train.algos.random_agent import RandomAlgorithm
from iphyre_jax.train.algos.sac import SACAlgorithm
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.predictions import first_predictions
from iphyre_jax.train.settings.agents import AgentName
from iphyre_jax.train.settings.run import TrainConfig

ALGORITHMS: Final[Mapping[AgentName, type[Algorithm[Any]]]] = MappingProxyType(
    {
        "ppo": PPOAlgorithm,
        "a2c": A2CAlgorithm,
        "sac": SACAlgorithm,
        "ddpg": DDPGAlgorithm,
        "dqn": DQNAlgorithm,
        "random": RandomAlgorithm,
    }
)


def algorithm(config: TrainConfig) -> Algorithm[Any]:
    """The algorithm of a configuration; that of all seeds is one, so that they share compiled programs."""
    return ALGORITHMS[config.agent](replace(config, seed=0), config.learner)


def init(config: TrainConfig, key: jax.Array) -> State:
    """The state of a configuration's algorithm before the first update.

    Raises:
        ValueError: one line; a setting cannot work.
    """
    config.check()
    obs = start_observations(config.strategy, config.observation, config.training_games)
    return _initial(algorithm(config), key, first_predictions(config, obs))


@partial(jax.jit, static_argnums=0)
def _initial(algorithm: Algorithm[Any], key: jax.Array, obs: jax.Array) -> State:
    """One program. Without it a network of attention compiles some two hundred, one for each operation and shape."""
    return algorithm.init(key, obs)

"""Plans of many scenes at once that a ranker is asked about: random ones, or those of policies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.policy_tries import TEMPERATURE, distributions, warm_samples
from iphyre_jax.envs.in_advance import action_to_times
from iphyre_jax.models.outcome.plays.pool import wide_plans
from iphyre_jax.scenes import Scene
from iphyre_jax.train.algos.actor_critic import ActorCritic
from iphyre_jax.train.algos.base import State
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.settings.run import TrainConfig

Floats = npt.NDArray[np.float64]
Propose = Callable[[Sequence[Scene], int, np.random.Generator], Floats]
"""Of S scenes, a number and a generator: so many plans of each, (S, count, 6) s; NaN for a block that stays."""


def random_proposals(scenes: Sequence[Scene], count: int, rng: np.random.Generator) -> Floats:
    """To do nothing, and random plans."""
    times = np.stack([wide_plans(len(scene.eliminable_blocks), count, rng) for scene in scenes])
    times[:, 0] = np.nan
    return times


def proposals_of(policies: Callable[[], Sequence[tuple[TrainConfig, State]]]) -> Propose:
    """How policies in advance propose: for each scene one of them, its greedy plan and samples, as `PolicyTries` does.

    Args:
        policies: gives settings with the head "time_grid", and states, if they are needed.
    """
    loaded = cache(policies)

    def propose(scenes: Sequence[Scene], count: int, rng: np.random.Generator) -> Floats:
        times = np.full((len(scenes), count, 6), np.nan)
        policy = rng.integers(len(loaded()), size=len(scenes))
        for number, (config, state) in enumerate(loaded()):
            own = np.flatnonzero(policy == number).tolist()
            if own:
                times[own] = _plans(config, state, [scenes[index] for index in own], count, rng)
        blocks = np.array([len(scene.eliminable_blocks) for scene in scenes])
        missing = np.arange(times.shape[2]) >= blocks[:, None, None]
        return np.where(missing | (times <= 0), np.nan, times)  # an action of 0 is never

    return propose


def _plans(config: TrainConfig, state: State, scenes: Sequence[Scene], count: int, rng: np.random.Generator) -> Floats:
    """A policy's greedy plan of each scene, and samples, (S, count, 6) s."""
    agent = algorithm(config)
    assert isinstance(agent, ActorCritic)  # noqa: S101 - only its agents have the head
    distribution = distributions(agent, state, start_observations(config.strategy, config.observation, scenes))
    sampled = warm_samples(agent, distribution, TEMPERATURE, count - 1, rng).reshape(len(scenes), count - 1, -1)
    drawn = jnp.concatenate([agent.head.mode(distribution)[:, None], sampled], axis=1)
    actions = agent.head.action(drawn.reshape(len(scenes) * count, -1))
    return np.asarray(action_to_times(np.asarray(actions)), np.float64).reshape(len(scenes), count, -1)

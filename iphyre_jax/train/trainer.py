"""One round of training: play, learn, report. Pure but for the clock: the same state gives the same round."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.collect import Decision, collector
from iphyre_jax.train.scenes import training_scenes
from iphyre_jax.train.settings.run import TrainConfig

COLUMNS = ("update", "episodes", "decisions", "reward", "success", "greedy_reward", "faults")
CLOCKS = ("seconds", "play_seconds", "learn_seconds")  # the only columns that differ between runs of one seed


class RunState(NamedTuple):
    """All that a round changes, and all that a checkpoint keeps."""

    learner: Any  # of the algorithm
    key: jax.Array  # random key of the rounds to come
    update: np.ndarray[Any, np.dtype[np.int32]]  # () rounds made
    decisions: np.ndarray[Any, np.dtype[np.int32]]  # () made by episodes that were not over


Line = dict[str, int | float | None]  # of metrics.csv


def start(config: TrainConfig) -> RunState:
    """The state before the first round.

    Raises:
        ValueError: one line; a setting cannot work.
    """
    config.check()
    learner_key, key = jax.random.split(jax.random.key(config.seed))
    return RunState(init(config, learner_key), key, np.zeros((), np.int32), np.zeros((), np.int32))


def columns(config: TrainConfig) -> tuple[str, ...]:
    """The columns of metrics.csv for a configuration's algorithm."""
    return (*COLUMNS, *algorithm(config).METRICS, *CLOCKS)


class Trainer:
    """Plays and learns round by round.

    Attributes:
        state: of the run; always whole, whenever an interrupt comes.
    """

    def __init__(self, config: TrainConfig, state: RunState) -> None:
        self.state = state
        self._config = config
        self._algorithm = algorithm(config)
        self._games = collector(config, config.training_games)
        self._begun = time.monotonic()

    def round(self) -> Line:
        """Play and learn once; returns the round's line of metrics."""
        config, state, begin = self._config, self.state, time.monotonic()
        update = int(state.update) + 1
        key, play_key, learn_key = jax.random.split(state.key, 3)
        scenes, episodes = training_scenes(config, update)
        place = collector(config, scenes) if config.variations else self._games
        act = partial(self._algorithm.act, config, state.learner)
        trajectory, played = place.collect(act, play_key, episodes)
        made = int(trajectory.active.sum())
        measured = update % config.greedy_every == 0 or update in (1, config.updates)
        greedy = self.greedy_reward() if measured else None
        learning = time.monotonic()
        learner, metrics = self._algorithm.learn(config, state.learner, learn_key, trajectory, len(scenes))
        learner, metrics = jax.block_until_ready((learner, metrics))
        self.state = RunState(learner, key, state.update + 1, state.decisions + made)
        end = time.monotonic()
        return {
            "update": update,
            "episodes": update * config.episodes_per_update,
            "decisions": int(self.state.decisions),
            "reward": float(played.reward.mean()),
            "success": float(played.success.mean()),
            "greedy_reward": greedy,
            "faults": int((played.fault != 0).sum()),
            **{name: float(metrics[name]) for name in self._algorithm.METRICS},
            "seconds": end - self._begun,
            "play_seconds": learning - begin,
            "learn_seconds": end - learning,
        }

    def greedy_reward(self) -> float:
        """Mean reward of greedy episodes, one of each training game, with what was learned so far."""
        learner = self.state.learner

        def act(key: jax.Array, observation: jax.Array, each: int) -> Decision:
            sampled = self._algorithm.act(self._config, learner, key, observation, each)
            return sampled._replace(action=self._algorithm.greedy(self._config, learner, observation))

        return float(self._games.collect(act, jax.random.key(0), 1)[1].reward.mean())

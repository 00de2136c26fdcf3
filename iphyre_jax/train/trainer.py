"""One update of training: play, learn, report. Pure but for the clock: the same state gives the same update."""

from __future__ import annotations

import time
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np

from iphyre_jax.execution.devices import on_cpu
from iphyre_jax.train.algos.base import not_finite, preferring
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.collect import rollout_collector
from iphyre_jax.train.pool import draw_scenes, open_pool, recorded, start_curriculum
from iphyre_jax.train.scenes import training_scenes
from iphyre_jax.train.settings.run import TrainConfig

COLUMNS = ("update", "episodes", "decisions", "reward", "success", "greedy_reward", "faults")
TIMING_COLUMNS = ("seconds", "play_seconds", "learn_seconds")  # all that differs between two runs of one seed

MAX_DECISIONS = 2**31 - 1  # as a checkpoint counts them; the count stays there, the run goes on


class RunState(NamedTuple):
    """All that an update changes, and all that a checkpoint keeps."""

    learner: Any  # of the algorithm
    key: jax.Array  # random key of the updates to come
    update: np.ndarray[Any, np.dtype[np.int32]]  # () updates made
    decisions: np.ndarray[Any, np.dtype[np.int32]]  # () made so far by episodes that had not ended
    curriculum: Any = ()  # `Curriculum` of the pool, if there is one


Metrics = dict[str, int | float | None]  # a line of metrics.csv


def start(config: TrainConfig) -> RunState:
    """The state before the first update.

    Raises:
        ValueError: one line; a setting cannot work.
    """
    config.check()
    learner_key, key = jax.random.split(jax.random.key(config.seed))
    counts = np.zeros((), np.int32), np.zeros((), np.int32)
    return RunState(init(config, learner_key), key, *counts, start_curriculum(config))


def columns(config: TrainConfig) -> tuple[str, ...]:
    """The columns of metrics.csv for a configuration's algorithm."""
    return (*COLUMNS, *algorithm(config).METRICS, *TIMING_COLUMNS)


class Trainer:
    """Plays and learns, update by update.

    Args:
        config: of the run.
        state: of the run so far.
        seconds: that the run has taken so far.

    Attributes:
        state: of the run; complete at any moment, even when an interrupt comes.

    Raises:
        OSError, ValueError: one line; the scene pool is not what the settings say.
    """

    def __init__(self, config: TrainConfig, state: RunState, seconds: float = 0.0) -> None:
        self.state = state
        self._config = config
        self._algorithm = algorithm(config)
        self._pool = open_pool(config)
        self._games = rollout_collector(config, config.training_games)
        self._begun = time.monotonic() - seconds

    def update_step(self) -> Metrics:
        """Play and learn once; returns the metrics of the update.

        Raises:
            ValueError: training has diverged: the policy is no longer finite; one line. `state` is that before it.
        """
        config, state, begin = self._config, self.state, time.monotonic()
        update = int(state.update) + 1
        key, play_key, learn_key = jax.random.split(state.key, 3)
        scenes, episodes = training_scenes(config, update)
        which: np.ndarray[Any, np.dtype[np.integer[Any]]] = np.zeros(0, np.int64)
        if self._pool is not None:
            count = len(config.training_games) * config.pool_groups
            which = draw_scenes(self._pool, state.curriculum, count, config, update)
            scenes = [*scenes, *(self._pool.scenes[k] for k in which)]
        same = not (config.variations or config.scene_pool)
        rollout = self._games if same else rollout_collector(config, scenes)
        trajectory, stats = rollout.collect(partial(self._algorithm.sample_action, state.learner), play_key, episodes)
        decisions = np.asarray(min(int(state.decisions) + int(trajectory.active.sum()), MAX_DECISIONS), np.int32)
        measured = update % config.greedy_every == 0 or update in (1, config.updates)
        greedy = self.greedy_reward() if measured else None
        learning = time.monotonic()
        learner, metrics = self._algorithm.learn(state.learner, learn_key, trajectory, len(scenes))
        learner, metrics = jax.block_until_ready((learner, metrics))
        if name := not_finite(self._algorithm.inference_state(learner)):
            raise ValueError(f"update {update}: {name}: expected finite numbers, got NaN or infinity: it diverged")
        curriculum = state.curriculum
        if len(which):
            curriculum = recorded(curriculum, which, stats.success.reshape(len(scenes), -1)[-len(which) :])
        self.state = RunState(learner, key, state.update + 1, decisions, curriculum)
        end = time.monotonic()
        return {
            "update": update,
            "episodes": update * config.episodes_per_update,
            "decisions": int(decisions),
            "reward": float(stats.reward.mean()),
            "success": float(stats.success.mean()),
            "greedy_reward": greedy,
            "faults": int((stats.fault != 0).sum()),
            **{name: None if np.isnan(value := float(metrics[name])) else value for name in self._algorithm.METRICS},
            "seconds": end - self._begun,
            "play_seconds": learning - begin,
            "learn_seconds": end - learning,
        }

    def greedy_reward(self) -> float:
        """Mean reward of the present policy's greedy episodes, one of each training game."""
        policy = preferring(self._algorithm.greedy_policy(self.state.learner))
        # Each number of worlds of an environment is a program of its own, which an accelerator compiles in half a
        # minute. So greedy episodes take that of sampled ones; more worlds cost little there.
        many = not (on_cpu() or self._config.strategy == "in-advance")
        repeats = self._config.episodes_per_scene if many else 1
        return float(self._games.collect(policy, jax.random.key(0), repeats)[1].reward[::repeats].mean())

"""The training run: play, learn, log, show progress, and leave a usable folder however it ends."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from iphyre_jax.env import Episodes, observation_table, play
from iphyre_jax.train import ppo, runs
from iphyre_jax.train.config import TrainConfig

GREEDY_EVERY = 10  # rounds between measurements of the greedy plans, for the learning curve


class Outcome(NamedTuple):
    """What a training run ends with."""

    folder: Path
    state: ppo.TrainState
    finished: bool  # False if it was interrupted


def train(config: TrainConfig, folder: Path, console: Console) -> Outcome:
    """Train a policy and write its run folder.

    An interrupt (Ctrl-C) ends the training after what was learned so far; the folder then holds the
    checkpoint, the metrics and the curve of that.

    Args:
        config: all settings.
        folder: new or empty folder of the run.
        console: for the folder's name and the progress bar.

    Raises:
        ValueError: one line, if the folder is in use.
    """
    run = runs.create(folder, config)
    console.print(f"Run folder: {folder}")
    trainer = Trainer(config)
    finished = False
    try:
        with _progress(console) as progress:
            task = progress.add_task("train", total=config.updates, status="compiling the physics of the games")
            for update in range(1, config.updates + 1):
                measure = update % GREEDY_EVERY == 0 or update in (1, config.updates)
                line = trainer.round(update, measure)
                run.log(line)
                progress.update(task, advance=1, status=_status(line))
        finished = True
    except KeyboardInterrupt:
        console.print("Interrupted; saving what was learned.")
    finally:
        with _uninterrupted():
            run.close(trainer.state)
    return Outcome(folder, trainer.state, finished)


class Trainer:
    """The state of a run on the host: the learner's state and the table of observations.

    Attributes:
        state: of the learner; always whole, whenever an interrupt comes.
    """

    def __init__(self, config: TrainConfig) -> None:
        self.state = ppo.init(config)
        self._config = config
        self._table = observation_table(config.training_games)
        self._which = np.repeat(np.arange(len(config.training_games)), config.plans_per_scene)
        self._seen = jnp.asarray(self._table[self._which])
        self._start = time.monotonic()

    def round(self, update: int, measure_greedy: bool) -> runs.Round:
        """Play and learn once; `update` counts from 1."""
        config = self._config
        begin = time.monotonic()
        key, plan_key = jax.random.split(self.state.key)
        actions, choice, log_prob = ppo.collect(config, self.state.params, plan_key, self._seen)
        plans = np.asarray(actions)
        play_begin = time.monotonic()
        played = self._play(self._which, plans)
        greedy = self._greedy_reward() if measure_greedy else None
        play_end = time.monotonic()
        reward = jnp.asarray(played.reward.reshape(len(config.training_games), -1), jnp.float32)
        advantage = ppo.scene_advantage(reward, config.std_floor).reshape(-1)
        batch = ppo.Batch(self._seen, choice, log_prob, advantage)
        state, metrics = ppo.learn(config, self.state._replace(key=key), batch)
        self.state = jax.block_until_ready(state)
        end = time.monotonic()
        return runs.Round(
            update=update,
            episodes=update * config.episodes_per_update,
            seconds=end - self._start,
            reward=float(played.reward.mean()),
            success=float(played.success.mean()),
            greedy_reward=greedy,
            **{name: float(value) for name, value in metrics._asdict().items()},
            faults=int((played.fault != 0).sum()),
            play_seconds=play_end - play_begin,
            learn_seconds=(end - begin) - (play_end - play_begin),
        )

    def _play(self, which: np.ndarray, actions: np.ndarray) -> Episodes:
        """Play training games with the run's settings."""
        config = self._config
        return play(config.training_games, which, actions, fps=config.fps, resets=config.resets, dtype=config.dtype)

    def _greedy_reward(self) -> float:
        """Mean reward of the greedy plans in the training games."""
        actions = ppo.greedy(self._config, self.state.params, jnp.asarray(self._table))
        return float(self._play(np.arange(len(self._table)), np.asarray(actions)).reward.mean())


def _progress(console: Console) -> Progress:
    """The progress bar: rounds, time, rate and current reward."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}"),
        console=console,
    )


def _status(line: runs.Round) -> str:
    """Rate and reward of a round, for the progress bar."""
    rate = line.episodes / line.update / (line.play_seconds + line.learn_seconds)
    return f"{rate:,.0f} episodes/s  reward {line.reward:.1f}"


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Put off Ctrl-C while a run is being saved (it can only be put off in the main thread)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)

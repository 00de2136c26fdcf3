"""The training run: rounds, logs, checkpoints, progress. Killed at any moment, it can be resumed to the same bits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from iphyre_jax.train import trainer
from iphyre_jax.train.reports.curve import draw_curve
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, runs
from iphyre_jax.train.storage.logs import Log
from iphyre_jax.train.trainer import Line, RunState, Trainer


class Outcome(NamedTuple):
    """What a training run ends with."""

    folder: Path
    state: RunState
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
    runs.create(folder, config)
    console.print(f"Run folder: {folder}")
    return _go_on(config, folder, trainer.start(config), console)


def resume(folder: Path, console: Console, name: str | None = None) -> Outcome:
    """Go on with an interrupted run from a checkpoint, the newest by default; without any, from the start.

    Lines of metrics.csv after the checkpoint are written again, the same but for the columns of the clock.

    Raises:
        FileNotFoundError, ValueError: one line; it is no run folder, or the checkpoint is damaged or of other versions.
    """
    config = runs.read_config(folder)
    if name is None and not checkpoint.names(folder):
        state = trainer.start(config)
    else:
        state = checkpoint.load(folder, config, name, to_resume=True)
    for later in checkpoint.names(folder):
        if int(later) > int(state.update):  # damaged, or it would not have been passed over
            checkpoint.remove(folder, later)
    console.print(f"Run folder: {folder}, {int(state.update)} of {config.updates} rounds made")
    return _go_on(config, folder, state, console)


def _go_on(config: TrainConfig, folder: Path, state: RunState, console: Console) -> Outcome:
    """Make the rounds that are left."""
    runner = Trainer(config, state)
    log = Log(folder, trainer.columns(config), int(state.update), tensorboard=config.tensorboard)
    finished, saved = False, time.monotonic()
    try:
        with _progress(console) as progress:
            status = "compiling the physics of the games"
            task = progress.add_task("train", total=config.updates, completed=int(state.update), status=status)
            for _ in range(int(state.update), config.updates):
                line = runner.round()
                log.add(line)
                progress.update(task, advance=1, status=_status(line, config))
                if time.monotonic() - saved >= config.checkpoint_seconds:
                    checkpoint.save(folder, config, runner.state)
                    saved = time.monotonic()
        finished = True
    except KeyboardInterrupt:
        console.print("Interrupted; saving what was learned.")
    finally:
        with _uninterrupted():
            checkpoint.save(folder, config, runner.state)
            log.close()
            draw_curve(folder, config)
    return Outcome(folder, runner.state, finished)


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


def _status(line: Line, config: TrainConfig) -> str:
    """Rate and reward of a round, for the progress bar."""
    rate = config.episodes_per_update / ((line["play_seconds"] or 0.0) + (line["learn_seconds"] or 0.0))
    return f"{rate:,.0f} episodes/s  reward {line['reward']:.1f}"


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

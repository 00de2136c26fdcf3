"""The training run: updates, logs, checkpoints, progress. A run killed at any moment resumes to the same bits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from rich.console import Console

from iphyre_jax.execution.configuration import default_options
from iphyre_jax.locks import locked
from iphyre_jax.train import trainer
from iphyre_jax.train.pool import with_sum
from iphyre_jax.train.predictions import with_prediction_sum
from iphyre_jax.train.progress import training_progress
from iphyre_jax.train.reports.curve import draw_curve
from iphyre_jax.train.reports.printing import say
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs, runs
from iphyre_jax.train.storage.logs import Log
from iphyre_jax.train.storage.named_files import copy_scenes, with_whole_paths
from iphyre_jax.train.trainer import Metrics, RunState, Trainer

SIGNALS: Final = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)  # that end a process; Windows has no SIGHUP


class TrainingResult(NamedTuple):
    """How a training run ended."""

    folder: Path
    state: RunState
    finished: bool  # False if it was interrupted


@default_options()
def train(config: TrainConfig, folder: Path | None, console: Console) -> TrainingResult:
    """Train a policy and write its run folder.

    An interrupt (Ctrl-C) ends the training early; the folder then holds the checkpoint, the metrics and the curve up
    to that point. So does any signal whose handler raises KeyboardInterrupt, as those of the command line do. A signal
    that comes while something is being saved waits for the end of it.

    Args:
        config: all settings.
        folder: new or empty folder of the run; None for a new one in `runs`.
        console: for the folder's name and the progress bar.

    Raises:
        ValueError: one line; the folder is not empty, the scene pool is not what it should be, or an extra is missing.
        OSError: one line; another process trains there, or a file cannot be written. What was saved can be resumed.
    """
    config.check_start()
    config = with_prediction_sum(with_sum(with_whole_paths(config)))
    if config.tensorboard:
        logs.import_tensorboard()
    folder = folder or runs.new_folder(config)  # only now: a run that is refused leaves none
    runs.make_folder(folder)
    with locked(folder):
        runs.create(folder, config)
        say(console, f"Run folder: {folder}")
        return _continue(config, folder, trainer.start(config), console)


@default_options()
def resume(folder: Path, console: Console, name: str | None = None) -> TrainingResult:
    """Continue an interrupted run from a checkpoint, by default the newest; if there is none, from the start.

    Lines of metrics.csv after the checkpoint are written again; only the timing columns differ.

    Raises:
        FileNotFoundError, ValueError: one line; the folder is no run, or the checkpoint is damaged or from other
            versions of the packages.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    config = runs.read_config(folder)
    runs.check_scenes(folder, config)
    with locked(folder):
        copy_scenes(folder, config)  # which a kill left out, or a version that kept none
        if name is None and not checkpoint.names(folder):
            state = trainer.start(config)
        else:
            state = checkpoint.load(folder, config, name, to_resume=True)
        say(console, f"Run folder: {folder}, {int(state.update)} of {config.updates} updates made")
        if change := runs.other_machine(folder):
            say(console, f"Run folder: {change}.")
        return _continue(config, folder, state, console)


def _continue(config: TrainConfig, folder: Path, state: RunState, console: Console) -> TrainingResult:
    """Make the updates that are left."""
    update = int(state.update)
    trained = Trainer(config, state, _seconds(folder, update))  # refuses other files before anything is removed
    for later in checkpoint.names(folder):
        if int(later) > update:  # damaged, or another one was named
            say(console, f"Checkpoint {later} is removed: the run goes on from an earlier one.")
            checkpoint.remove(folder, later)
    log = Log(folder, trainer.columns(config), update, tensorboard=config.tensorboard)
    if log.missing:
        lost = f"expected a line for each of {update} updates, but {log.missing} are missing"
        say(console, f"{folder / logs.FILE}: {lost}; the run goes on without them")
    finished, saved = False, time.monotonic()
    try:
        with training_progress(console) as progress:
            status = "compiling the physics of the games"
            task = progress.add_task("train", total=config.updates, completed=update, status=status)
            for _ in range(update, config.updates):
                metrics = trained.update_step()
                with _signals_held():
                    log.add(metrics)
                    state = trained.state  # what is saved has a line, whenever an interrupt or a full disk comes
                    if time.monotonic() - saved >= config.checkpoint_seconds:
                        log.sync()
                        checkpoint.save(folder, config, state)
                        saved = time.monotonic()
                progress.update(task, advance=1, status=_status(metrics, config))
        finished = True
    except KeyboardInterrupt:
        console.print("Interrupted; saving the run.")
    finally:
        with _signals_held(drop=not finished):
            try:
                log.sync()
                checkpoint.save(folder, config, state)
            finally:
                log.close()
            draw_curve(folder, config)
    return TrainingResult(folder, state, finished)


def _seconds(folder: Path, update: int) -> float:
    """What a run had taken after so many updates."""
    lines = logs.read(folder, ("seconds",)) if (folder / logs.FILE).is_file() else []
    taken = [float(line["seconds"]) for line in lines if int(line["update"]) <= update]
    return taken[-1] if taken else 0.0


def _status(metrics: Metrics, config: TrainConfig) -> str:
    """Rate and reward of an update, for the progress bar."""
    rate = config.episodes_per_update / ((metrics["play_seconds"] or 0.0) + (metrics["learn_seconds"] or 0.0))
    return f"{rate:,.0f} episodes/s  reward {metrics['reward']:.1f}"


@contextmanager
def _signals_held(*, drop: bool = False) -> Iterator[None]:
    """Hold back Ctrl-C and other signals that interrupt while files are written; they come at the end, or never.

    Signals without a handler in Python keep their meaning. Only the main thread can do this; no other is interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    held: list[int] = []
    handlers = {number: handler for number in SIGNALS if callable(handler := signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda came, _: held.append(came))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    if held and not drop:
        signal.raise_signal(held[0])

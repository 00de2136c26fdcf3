"""Train a world model, or go on where it stopped. A run killed at any moment ends with the same bits."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import jax
from rich.console import Console

from iphyre_jax.execution.configuration import default_options
from iphyre_jax.locks import locked
from iphyre_jax.models.storage import check_losses
from iphyre_jax.models.world import storage
from iphyre_jax.models.world.plays import learned_plays
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import Plays
from iphyre_jax.models.world.training import TrainState, start, train_chunk
from iphyre_jax.train.progress import training_progress

RENEWED: Final = 5  # chunks of steps after which there are new plays, if they are unlimited


@default_options()
def train(folder: Path, config: WorldConfig, console: Console, plays: Plays | None = None) -> TrainState:
    """Train a world model, or what is left of it.

    Args:
        folder: of the run; a new one, or one with the same settings.
        config: settings.
        console: for the progress bar.
        plays: to learn from; by default those that the settings name.

    Raises:
        ValueError: one line; the folder holds another run, or a damaged one, or training has diverged.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        storage.RUNS.create(folder, config)
        state, losses = start(config), list[float]()
        if (saved := storage.load(folder, state)) is not None:
            state, losses = saved
        with training_progress(console) as progress:
            done = len(losses) * config.chunk
            bar = progress.add_task(config.name, total=config.steps, completed=done, status="compiling")
            material: tuple[int, Plays] | None = None
            for first in range(done, config.steps, config.chunk):
                part = first // config.chunk // RENEWED if config.data == "unlimited" else 0
                if material is None or material[0] != part:
                    found = learned_plays(config.data, config.seed, part) if plays is None else plays
                    material = (part, jax.device_put(found))
                state, loss = train_chunk(config, state, material[1], first)
                check_losses(folder, loss, f"step {first}")
                losses.append(loss)
                storage.save(folder, config, state, losses)
                progress.update(bar, advance=config.chunk, status=f"loss {loss:.4f}")
    return state

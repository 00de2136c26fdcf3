"""Train a row, or go on where it stopped, and measure it. A run killed at any moment ends with the same bits."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from iphyre_jax.execution.configuration import default_options
from iphyre_jax.files import replace_json
from iphyre_jax.locks import locked
from iphyre_jax.models.sequence import evaluation, storage
from iphyre_jax.models.sequence.episodes import SequenceData
from iphyre_jax.models.sequence.settings import SequenceConfig
from iphyre_jax.models.sequence.training import SequenceState, of_seed, start, train_chunk
from iphyre_jax.models.storage import EVALUATION, VERSION, check_losses, parameter_count
from iphyre_jax.provenance import provenance
from iphyre_jax.train.progress import training_progress


@default_options()
def train(
    folder: Path, config: SequenceConfig, data: SequenceData, plays: Mapping[str, Any], console: Console
) -> SequenceState:
    """Train the models of a row, or what is left of it.

    Args:
        folder: of the run; a new one, or one with the same settings and plays.
        config: settings.
        data: what is learned from.
        plays: their number and sum.
        console: for the progress bar.

    Raises:
        ValueError: one line; the folder holds another run, or a damaged one, or training has diverged.
        OSError: one line; another process trains there, or a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        storage.RUNS.create(folder, config, plays=dict(plays))
        arrays = jax.device_put(data)
        state, losses = start(config, arrays), np.zeros((0, config.seeds), np.float32)
        if (saved := storage.load(folder, state)) is not None:
            state, losses = saved
        with training_progress(console) as progress:
            bar = progress.add_task(config.name, total=config.updates, completed=len(losses), status="compiling")
            for first in range(len(losses), config.updates, config.chunk):
                state, made = train_chunk(config, arrays, jnp.int32(first), state)
                check_losses(folder, made, f"update {first}")
                losses = np.concatenate([losses, np.asarray(made)])
                storage.save(folder, config, state, losses)
                progress.update(bar, advance=config.chunk, status=f"loss {losses[-config.chunk :].mean():.3f}")
    return state


def evaluate(folder: Path, config: SequenceConfig, state: SequenceState) -> dict[str, Any]:
    """Let the models of a run play and write evaluation.json."""
    content = {
        "schema": storage.RUNS.schema,
        "version": VERSION,
        "row": config.name,
        "settings": config.to_json(),
        "parameters": parameter_count(state.params),
        "modes": evaluation.evaluate(config, state.params, config.seeds),
        **provenance(),
    }
    replace_json(folder / EVALUATION, content)
    return content


def shipped(config: SequenceConfig, state: SequenceState, found: Mapping[str, Any]) -> storage.TrainedSequenceModel:
    """The best model of a run, rounded as it ships: chosen on the basic and the unseen basic games, no others."""
    result = found["modes"]["greedy"]
    scores = np.mean([evaluation.split_means(result, split)[0] for split in ("basic", "unseen_basic")], axis=0)
    seed = int(np.argmax(scores))
    reward = {split: float(evaluation.split_means(result, split)[0][seed]) for split in ("basic", "all")}
    origin = {
        "seed": seed,
        "chosen by": "mean reward on basic and on unseen basic games, greedy",
        "reward": reward,
        "trained": provenance(),
    }
    return storage.TrainedSequenceModel(config.name, config, storage.FILES.rounded(of_seed(state.params, seed)), origin)

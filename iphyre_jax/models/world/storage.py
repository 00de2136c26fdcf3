"""Run folders of world models, and the trained ones that ship with the package.

config.json       settings, versions, machine, commit
state.npz         the whole state after the last chunk of steps, and the losses; whole at any moment
metrics.csv       one line a chunk
evaluation.json   what the trained model is worth

A trained model is NAME.npz, its parameters in float32, and NAME.json, with the sum of the former.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np

from iphyre_jax.checks import show
from iphyre_jax.files import pack_npz, read_json_object, replace_bytes, replace_text
from iphyre_jax.models.storage import CONFIG, METRICS, STATE, RunFolders, TrainedModel, WeightFiles, read_state
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.training import TrainState, start
from iphyre_jax.provenance import provenance
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored

RUNS: Final = RunFolders("iphyre_jax/world-run", WorldConfig, measures=2)
FILES: Final = WeightFiles("iphyre_jax/world-model", WorldConfig, "model", np.float32)
LOSSES: Final = "losses"
WEIGHTS: Final = Path(str(files("iphyre_jax.models.world").joinpath("weights")))

WorldModel = TrainedModel[WorldConfig]


def save(folder: Path, config: WorldConfig, state: TrainState, losses: list[float]) -> None:
    """Write the state of a run after some chunks."""
    arrays = {**named_arrays(state), LOSSES: np.asarray(losses, np.float64)}
    replace_bytes(folder / STATE, pack_npz(arrays))
    lines = [f"{(k + 1) * config.chunk},{loss:.6f}" for k, loss in enumerate(losses)]
    replace_text(folder / METRICS, "\n".join(["step,loss", *lines]) + "\n")


def load(folder: Path, like: TrainState) -> tuple[TrainState, list[float]] | None:
    """What `save` wrote; None if nothing was.

    Raises:
        ValueError: one line; the file is damaged or belongs to other settings.
    """
    arrays = read_state(folder)
    if arrays is None:
        return None
    losses = arrays.pop(LOSSES, np.zeros(0))
    return restored(arrays, like, folder / STATE), losses.tolist()


def trained_model(folder: Path) -> WorldModel:
    """The model of a run as it stands.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    config = RUNS.read_config(folder)
    saved = load(folder, start(config))
    if saved is None:
        raise FileNotFoundError(f"{folder}: not trained yet, there is no {STATE}")
    described = read_json_object(folder / CONFIG)
    trained = {key: described.get(key) for key in provenance()}  # where it was, not where we are
    return WorldModel(config.name, config, saved[0].params, {"steps": len(saved[1]) * config.chunk, "trained": trained})


def named_file(name: str) -> Path:
    """The file of the parameters of a model of the package by its name, or of a run by its folder.

    Raises:
        ValueError: one line; there is no such model.
    """
    file = WEIGHTS / f"{name}.npz" if name in names() else Path(name) / STATE
    if not file.is_file():
        raise ValueError(f"model: expected one of {', '.join(names())}, or the run folder of one; got {show(name)}")
    return file


def named_model(name: str) -> WorldModel:
    """A model by its name or its run folder, as `named_file`.

    Raises:
        ValueError: one line; there is no such model, or its files are damaged.
    """
    file = named_file(name)
    return load_model(name) if file.parent == WEIGHTS else trained_model(file.parent)


def names() -> tuple[str, ...]:
    """The names of the trained models."""
    return FILES.names(WEIGHTS)


def load_model(name: str, folder: Path = WEIGHTS) -> WorldModel:
    """A trained model of the package, or of another folder.

    Raises:
        ValueError: one line; the name is unknown, or its files are damaged.
    """
    return FILES.load(folder, name, lambda config: start(config).params)

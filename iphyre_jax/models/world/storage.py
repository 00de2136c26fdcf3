"""Run folders of world models, and the trained ones that ship with the package.

config.json       settings, versions, machine, commit
state.npz         the whole state after the last chunk of steps, and the losses; whole at any moment
metrics.csv       one line a chunk
evaluation.json   what the trained model is worth

A trained model is NAME.npz, its parameters in float32, and NAME.json, with the sum of the former.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.checks import show
from iphyre_jax.files import (
    pack_npz,
    read_json_object,
    read_npz,
    read_versioned,
    replace_bytes,
    replace_json,
    replace_text,
)
from iphyre_jax.models.world.settings import WorldConfig, settings_from_json
from iphyre_jax.models.world.training import Params, TrainState, start
from iphyre_jax.provenance import provenance
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored, verify_sum

SCHEMA: Final = "iphyre_jax/world-run"
WEIGHTS_SCHEMA: Final = "iphyre_jax/world-model"
VERSION: Final = 1
CONFIG, STATE, METRICS, EVALUATION = "config.json", "state.npz", "metrics.csv", "evaluation.json"
LOSSES: Final = "losses"
MAX_STATE: Final = 2**28  # bytes
WEIGHTS: Final = Path(str(files("iphyre_jax.models.world").joinpath("weights")))


def create(folder: Path, config: WorldConfig) -> None:
    """Begin a run folder, or find the same run in it.

    Raises:
        ValueError: one line; the folder holds a run with other settings.
    """
    config.check()
    if (folder / CONFIG).is_file():
        if read_json_object(folder / CONFIG).get("settings") != config.to_json():
            raise ValueError(f"{folder / CONFIG}: settings: expected those of this run, found others; remove it")
        return
    folder.mkdir(parents=True, exist_ok=True)
    replace_json(folder / CONFIG, {"schema": SCHEMA, "version": VERSION, "settings": config.to_json(), **provenance()})


def read_config(folder: Path) -> WorldConfig:
    """The settings of a run.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    file = folder / CONFIG
    if not file.is_file():
        raise FileNotFoundError(f"{folder}: not a run folder, there is no {CONFIG}")
    return settings_from_json(read_versioned(file, SCHEMA, (VERSION,)).get("settings"), str(file))


def read_evaluation(folder: Path) -> dict[str, Any]:
    """The evaluation of a run.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    file = folder / EVALUATION
    if not file.is_file():
        raise FileNotFoundError(f"{folder}: not evaluated yet, there is no {EVALUATION}")
    return read_versioned(file, SCHEMA, (VERSION,))


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
    file = folder / STATE
    if not file.is_file():
        return None
    arrays = read_npz(file, MAX_STATE)
    losses = arrays.pop(LOSSES, np.zeros(0))
    return restored(arrays, like, file), losses.tolist()


@dataclass(frozen=True, eq=False)
class WorldModel:
    """A trained world model.

    Attributes:
        config: settings of its training.
        params: of its network.
        origin: how it was chosen and where it was trained.
    """

    config: WorldConfig
    params: Params
    origin: Mapping[str, Any]


def trained_model(folder: Path) -> WorldModel:
    """The model of a run as it stands.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    config = read_config(folder)
    saved = load(folder, start(config))
    if saved is None:
        raise FileNotFoundError(f"{folder}: not trained yet, there is no {STATE}")
    described = read_json_object(folder / CONFIG)
    trained = {key: described.get(key) for key in provenance()}  # where it was, not where we are
    return WorldModel(config, saved[0].params, {"steps": len(saved[1]) * config.chunk, "trained": trained})


def names(folder: Path = WEIGHTS) -> tuple[str, ...]:
    """The names of the trained models."""
    return tuple(sorted(file.stem for file in folder.glob("*.npz")))


def save_model(name: str, model: WorldModel, folder: Path = WEIGHTS) -> None:
    """Write the two files of a model."""
    content = pack_npz({key: np.asarray(leaf, np.float32) for key, leaf in named_arrays(model.params).items()})
    described = {
        "schema": WEIGHTS_SCHEMA,
        "version": VERSION,
        "settings": model.config.to_json(),
        "sha256": hashlib.sha256(content).hexdigest(),
        "origin": dict(model.origin),
    }
    folder.mkdir(parents=True, exist_ok=True)
    replace_bytes(folder / f"{name}.npz", content)
    replace_json(folder / f"{name}.json", described)


def load_model(name: str, folder: Path = WEIGHTS) -> WorldModel:
    """A trained model of the package, or of another folder.

    Raises:
        ValueError: one line; the name is unknown, or its files are damaged.
    """
    described, arrays = folder / f"{name}.json", folder / f"{name}.npz"
    if not (described.is_file() and arrays.is_file()):
        raise ValueError(f"model: expected one of {', '.join(names(folder)) or 'none'}; got {show(name)}")
    content = read_versioned(described, WEIGHTS_SCHEMA, (VERSION,))
    config = settings_from_json(content.get("settings"), str(described))
    verify_sum(arrays, content.get("sha256"))
    like = jax.eval_shape(lambda: start(config).params)
    params = restored(read_npz(arrays, MAX_STATE), like, arrays)
    return WorldModel(config, jax.tree.map(jnp.asarray, params), content.get("origin", {}))

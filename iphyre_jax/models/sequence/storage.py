"""Run folders of sequence models, and the trained ones that ship with the package.

config.json       settings, plays, versions, machine, commit
state.npz         the whole state after the last chunk of steps, with the losses; whole at any moment
metrics.csv       one line a chunk: means over steps and seeds
evaluation.json   what the trained models are worth

A trained model is NAME.npz, the parameters of one seed in float16, and NAME.json, with the sum of the former.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

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
from iphyre_jax.models.sequence.agent import Memory
from iphyre_jax.models.sequence.networks import SequenceModel
from iphyre_jax.models.sequence.settings import ASKED, SequenceConfig, settings_from_json
from iphyre_jax.models.sequence.training import Params, SequenceState
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored, verify_sum

SCHEMA: Final = "iphyre_jax/sequence-run"
WEIGHTS_SCHEMA: Final = "iphyre_jax/sequence-model"
VERSION: Final = 1
CONFIG, STATE, METRICS, EVALUATION = "config.json", "state.npz", "metrics.csv", "evaluation.json"
LOSSES: Final = "losses"
MAX_STATE: Final = 2**30  # bytes
WEIGHTS: Final = Path(str(files("iphyre_jax.models.sequence").joinpath("weights")))

Floats = npt.NDArray[np.float32]


def create(folder: Path, config: SequenceConfig, plays: Mapping[str, Any]) -> None:
    """Begin a run folder, or find the same run in it.

    Args:
        folder: of the run.
        config: settings.
        plays: what is learned from: its number and its sum.

    Raises:
        ValueError: one line; the folder holds a run with other settings or other plays.
    """
    config.check()
    found = {"settings": config.to_json(), "plays": dict(plays)}
    if (folder / CONFIG).is_file():
        content = read_json_object(folder / CONFIG)
        for field, value in found.items():
            if content.get(field) != value:
                raise ValueError(f"{folder / CONFIG}: {field}: expected those of this run, found others; remove it")
        return
    folder.mkdir(parents=True, exist_ok=True)
    replace_json(folder / CONFIG, {"schema": SCHEMA, "version": VERSION, **found, **provenance()})


def read_evaluation(folder: Path) -> dict[str, Any]:
    """The evaluation of a run.

    Raises:
        FileNotFoundError, ValueError: one line naming the file and what is wrong with it.
    """
    file = folder / EVALUATION
    if not file.is_file():
        raise FileNotFoundError(f"{folder}: not evaluated yet, there is no {EVALUATION}")
    return read_versioned(file, SCHEMA, (VERSION,))


def save(folder: Path, config: SequenceConfig, state: SequenceState, losses: Floats) -> None:
    """Write state and losses (updates, K) of a run after some chunks."""
    replace_bytes(folder / STATE, pack_npz({**named_arrays(state), LOSSES: losses}))
    chunks = losses.reshape(-1, config.chunk, losses.shape[1]).mean(axis=(1, 2))
    lines = [f"{(k + 1) * config.chunk},{value:.5f}" for k, value in enumerate(chunks)]
    replace_text(folder / METRICS, "\n".join(["updates,loss", *lines]) + "\n")


def load(folder: Path, like: SequenceState) -> tuple[SequenceState, Floats] | None:
    """What `save` wrote; None if nothing was.

    Args:
        folder: of the run.
        like: a state of the same settings, for its shapes.

    Raises:
        ValueError: one line; the file is damaged or belongs to other settings.
    """
    file = folder / STATE
    if not file.is_file():
        return None
    arrays = read_npz(file, MAX_STATE)
    losses = arrays.pop(LOSSES, np.zeros((0, 1), np.float32))
    return restored(arrays, like, file), losses


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A trained sequence model.

    Attributes:
        name: as in docs/results/sequence.md.
        config: settings of its training.
        params: of one model.
        origin: how the seed was chosen and where it was trained.
    """

    name: str
    config: SequenceConfig
    params: Params
    origin: Mapping[str, Any]


def names(folder: Path = WEIGHTS) -> tuple[str, ...]:
    """The names of the trained models."""
    return tuple(sorted(file.stem for file in folder.glob("*.npz")))


def rounded(params: Params) -> Params:
    """Parameters rounded to what ships: float16."""
    return jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf, np.float16), leaf.dtype), params)


def save_model(model: TrainedModel, folder: Path = WEIGHTS) -> None:
    """Write the two files of a model; its parameters are `rounded`."""
    content = pack_npz({name: np.asarray(leaf, np.float16) for name, leaf in named_arrays(model.params).items()})
    described = {
        "schema": WEIGHTS_SCHEMA,
        "version": VERSION,
        "settings": model.config.to_json(),
        "sha256": hashlib.sha256(content).hexdigest(),
        "origin": dict(model.origin),
    }
    folder.mkdir(parents=True, exist_ok=True)
    replace_bytes(folder / f"{model.name}.npz", content)
    replace_json(folder / f"{model.name}.json", described)


def load_model(name: str, folder: Path = WEIGHTS) -> TrainedModel:
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
    like = jax.eval_shape(lambda: _shapes(config))
    params = restored(read_npz(arrays, MAX_STATE), like, arrays)
    return TrainedModel(name, dataclasses.replace(config, seeds=1), params, content.get("origin", {}))


def _shapes(config: SequenceConfig) -> Params:
    """Parameters of one model of these settings."""
    one = np.zeros(1, np.int32)
    inputs = Memory.of(config, [load_scene("support")], one, ASKED).inputs(one)
    return SequenceModel(config).init(jax.random.key(0), inputs)

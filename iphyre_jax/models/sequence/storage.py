"""Run folders of sequence models, and the trained ones that ship with the package.

config.json       settings, plays, versions, machine, commit
state.npz         the whole state after the last chunk of steps, with the losses; whole at any moment
metrics.csv       one line a chunk: means over steps and seeds
evaluation.json   what the trained models are worth

A trained model is NAME.npz, the parameters of one seed in float16, and NAME.json, with the sum of the former.
"""

from __future__ import annotations

import dataclasses
from importlib.resources import files
from pathlib import Path
from typing import Final

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.files import pack_npz, replace_bytes, replace_text
from iphyre_jax.models.sequence.agent import Memory
from iphyre_jax.models.sequence.networks import SequenceModel
from iphyre_jax.models.sequence.settings import ASKED, SequenceConfig
from iphyre_jax.models.sequence.training import Params, SequenceState
from iphyre_jax.models.storage import METRICS, STATE, RunFolders, TrainedModel, WeightFiles, read_state
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored

RUNS: Final = RunFolders("iphyre_jax/sequence-run", SequenceConfig)
FILES: Final = WeightFiles("iphyre_jax/sequence-model", SequenceConfig, "model", np.float16)
LOSSES: Final = "losses"
WEIGHTS: Final = Path(str(files("iphyre_jax.models.sequence").joinpath("weights")))

Floats = npt.NDArray[np.float32]
TrainedSequenceModel = TrainedModel[SequenceConfig]


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
    arrays = read_state(folder)
    if arrays is None:
        return None
    losses = arrays.pop(LOSSES, np.zeros((0, 1), np.float32))
    return restored(arrays, like, folder / STATE), losses


def names() -> tuple[str, ...]:
    """The names of the trained models."""
    return FILES.names(WEIGHTS)


def load_model(name: str, folder: Path = WEIGHTS) -> TrainedSequenceModel:
    """A trained model of the package, or of another folder.

    Raises:
        ValueError: one line; the name is unknown, or its files are damaged.
    """
    loaded = FILES.load(folder, name, _shapes)
    return dataclasses.replace(loaded, config=dataclasses.replace(loaded.config, seeds=1))


def _shapes(config: SequenceConfig) -> Params:
    """Parameters of one model of these settings."""
    one = np.zeros(1, np.int32)
    inputs = Memory.of(config, [load_scene("support")], one, ASKED).inputs(one)
    return SequenceModel(config).init(jax.random.key(0), inputs)

"""Run folders of outcome classifiers, and the trained ones that ship with the package.

config.json       settings, data, versions, machine, commit
state.npz         the whole state after the last chunk of epochs, with what was measured; whole at any moment
metrics.csv       one line an epoch: means over the seeds
evaluation.json   what the trained networks are worth

A trained classifier is NAME.npz, one network's parameters in float16, and NAME.json, with the sum of the former.
"""

from __future__ import annotations

import dataclasses
import hashlib
from importlib.resources import files
from pathlib import Path
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.files import pack_npz, replace_bytes, replace_text
from iphyre_jax.models.outcome.networks.fusion import network
from iphyre_jax.models.outcome.plays.inputs import Plans, Scenes, scene_inputs
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import History, OutcomeState, Params
from iphyre_jax.models.storage import METRICS, STATE, RunFolders, TrainedModel, WeightFiles, read_state
from iphyre_jax.scenes import load_scene
from iphyre_jax.train.storage.checkpoint import named_arrays
from iphyre_jax.train.storage.weights import restored

RUNS: Final = RunFolders("iphyre_jax/outcome-run", OutcomeConfig)
FILES: Final = WeightFiles("iphyre_jax/outcome-classifier", OutcomeConfig, "classifier", np.float16)
HISTORY: Final = "history."
WEIGHTS: Final = Path(str(files("iphyre_jax.models.outcome").joinpath("weights")))

OutcomeClassifier = TrainedModel[OutcomeConfig]


def plays_sum(plays: Dataset) -> str:
    """A sum over all that is learned from a data set: other plays, another sum."""
    hasher = hashlib.sha256()
    for name in ("game", "times", "steps", "success", "end_step"):
        hasher.update(np.ascontiguousarray(getattr(plays, name)).tobytes())
    return hasher.hexdigest()


def save(folder: Path, state: OutcomeState, history: History) -> None:
    """Write state and measurements of a run after some epochs."""
    arrays = {**named_arrays(state), **{HISTORY + name: value for name, value in history._asdict().items()}}
    replace_bytes(folder / STATE, pack_npz(arrays))
    lines = ["epoch,loss,held_loss,held_accuracy"]
    for number, row in enumerate(zip(*(np.asarray(each).mean(axis=1) for each in history), strict=True), start=1):
        lines.append(",".join([str(number), *(f"{value:.5f}" for value in row)]))
    replace_text(folder / METRICS, "\n".join(lines) + "\n")


def load(folder: Path, like: OutcomeState) -> tuple[OutcomeState, History] | None:
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
    history = [arrays.pop(HISTORY + name, np.zeros(0)) for name in History._fields]
    return restored(arrays, like, folder / STATE), History(*(jnp.asarray(each) for each in history))


def names() -> tuple[str, ...]:
    """The names of the trained classifiers."""
    return FILES.names(WEIGHTS)


def rankers() -> tuple[str, ...]:
    """The names of those that rank a policy's plans, a scene at a time; `attempts.policy_tries` plays them."""
    return tuple(name for name in names() if FILES.config(WEIGHTS, name).network == "ranker")


def shipped_params(params: Params, seed: int) -> Params:
    """One network of several, as it ships: with an axis of one seed in front."""
    return FILES.rounded(jax.tree.map(lambda leaf: leaf[seed : seed + 1], params))


def load_classifier(name: str, folder: Path = WEIGHTS) -> OutcomeClassifier:
    """A trained classifier of the package, or of another folder.

    Raises:
        ValueError: one line; the name is unknown, or its files are damaged.
    """
    loaded = FILES.load(folder, name, _one_network)
    return dataclasses.replace(loaded, config=dataclasses.replace(loaded.config, seeds=1))


def _one_network(config: OutcomeConfig) -> Params:
    """Parameters of one network of these settings, with an axis of one seed in front."""
    scenes: Scenes = scene_inputs([load_scene("support")], config)
    plans, game = Plans(jnp.zeros((1, 12)), jnp.zeros((1, 12))), jnp.zeros(1, jnp.int32)
    params = network(config).init(jax.random.key(0), jnp.asarray(scenes.rows)[game], plans, scenes, game)
    return jax.tree.map(lambda leaf: leaf[None], params)

"""Saving and loading the state of a training run with orbax."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

from iphyre_jax.train import ppo
from iphyre_jax.train.config import TrainConfig

FOLDER = "checkpoint"


def save(folder: Path, state: ppo.TrainState) -> None:
    """Write `folder`/checkpoint, in place of an older one: weights, optimiser, random key, rounds made."""
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save((folder / FOLDER).absolute(), _named(_storable(state)), force=True)


def load(folder: Path, config: TrainConfig) -> ppo.TrainState:
    """The state that `save` wrote in `folder` for a run with these settings.

    Raises:
        FileNotFoundError: one line; there is no checkpoint.
        ValueError: one line; it cannot be read, or belongs to other settings.
    """
    path = (folder / FOLDER).absolute()
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: there is no checkpoint")
    state = jax.eval_shape(lambda: _storable(ppo.init(config)))
    expected = _named(state)
    try:
        with ocp.StandardCheckpointer() as checkpointer:
            found = checkpointer.metadata(path).item_metadata.tree
            # Compared before anything is read: orbax would leave its readers hanging at a wrong shape.
            if _forms(found) != _forms(expected):
                raise ValueError("it belongs to other settings than config.json says")
            stored = checkpointer.restore(path, expected)
    except Exception as error:  # orbax raises many kinds for a damaged folder
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path}: the checkpoint cannot be read: {reason}") from None
    leaves = [stored[name] for name in expected]
    restored: ppo.TrainState = jax.tree.unflatten(jax.tree.structure(state), leaves)
    return restored._replace(key=jax.random.wrap_key_data(restored.key))


def _storable(state: ppo.TrainState) -> ppo.TrainState:
    """The state with its random key as plain integers."""
    return state._replace(key=jax.random.key_data(state.key))


def _named(state: ppo.TrainState) -> dict[str, Any]:
    """Every array of the state under the path that leads to it, "params.params.Dense_0.bias" and so on, in order."""
    leaves, _ = jax.tree_util.tree_flatten_with_path(state)
    return {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}


def _forms(named: Mapping[str, Any]) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and dtype of each array."""
    return {name: (tuple(leaf.shape), str(leaf.dtype)) for name, leaf in named.items()}

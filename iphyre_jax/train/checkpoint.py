"""Saving and loading the state of a training run with orbax."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import jax
import orbax.checkpoint as ocp

from iphyre_jax.train import ppo
from iphyre_jax.train.config import TrainConfig

FOLDER = "checkpoint"


def save(folder: Path, state: ppo.TrainState) -> None:
    """Write `folder`/checkpoint, in place of an older one: weights, optimiser, random key, rounds made."""
    with ocp.StandardCheckpointer() as checkpointer:
        checkpointer.save((folder / FOLDER).absolute(), _storable(state), force=True)


def load(folder: Path, config: TrainConfig) -> ppo.TrainState:
    """The state that `save` wrote in `folder` for a run with these settings.

    Raises:
        FileNotFoundError: one line; there is no checkpoint.
        ValueError: one line; it cannot be read, or belongs to other settings.
    """
    path = (folder / FOLDER).absolute()
    if not path.is_dir():
        raise FileNotFoundError(f"{path}: there is no checkpoint")
    expected = jax.eval_shape(lambda: _storable(ppo.init(config)))
    try:
        with ocp.StandardCheckpointer() as checkpointer:
            stored = checkpointer.restore(path, expected)
    except Exception as error:  # orbax raises many kinds for a damaged folder
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path}: the checkpoint cannot be read: {reason}") from None
    return cast(ppo.TrainState, stored._replace(key=jax.random.wrap_key_data(stored.key)))


def _storable(state: ppo.TrainState) -> ppo.TrainState:
    """The state with its random key as plain integers."""
    return state._replace(key=jax.random.key_data(state.key))

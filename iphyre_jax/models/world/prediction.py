"""World models as predictions for agents that act on the fly or combined, by their name in a training's settings.

A model sees the observed table with velocities and says what it is 0.1 s later if nothing is removed now. On the fly
"mdrnn" goes on remembering: at each decision it is told what the one before removed, as in its training. Combined,
decisions are not 0.1 s apart, and it begins anew at each.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.params import EnvParams, EnvState
from iphyre_jax.files import file_sum
from iphyre_jax.models.world import storage
from iphyre_jax.models.world.interface import Memory, Params, Predict, predictor, start_memory
from iphyre_jax.models.world.tables import scene_tables
from iphyre_jax.observations.official import LENGTH_COLUMNS
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import MAX_OBJECTS, Scene
from iphyre_jax.train.observations import parts
from iphyre_jax.train.predictions import NamedPrediction, offer_world_models
from iphyre_jax.train.settings.run import PERFECT, ZEROS

MOST_WORLDS = 2048  # predicted at once: the pairs of so many take some 100 MB


class _Kept(NamedTuple):
    """What a prediction keeps of B episodes."""

    memory: Memory  # before `obs`
    obs: jax.Array | None  # (B, D) of the decision before; None at the first, and if the memory does not go on
    goes_on: bool  # whether the model remembers, and decisions are 0.1 s apart


class WorldPrediction:
    """The prediction of a trained model.

    Args:
        model: the model.
    """

    def __init__(self, model: storage.WorldModel) -> None:
        self._config, self._params = model.config, model.params

    def start(self, scenes: Sequence[Scene], game: jax.Array, environment: Environment, params: EnvParams) -> _Kept:
        """See `iphyre_jax.train.predictions.Prediction`."""
        del params
        tables = scene_tables(scenes)
        own = jax.device_put(jax.tree.map(lambda column: column[np.asarray(game)], tables))
        memory = start_memory(self._config, own)
        remembers = self._config.model == "mdrnn" and environment.strategy.name == "on-the-fly"
        return _Kept(memory, None, remembers)

    def predict(self, memory: _Kept, obs: jax.Array, state: EnvState) -> tuple[jax.Array, _Kept]:
        """See `iphyre_jax.train.predictions.Prediction`."""
        del state
        predict, now = predictor(self._config), memory.memory
        if memory.obs is not None:
            now = _remember(predict, self._params, now, memory.obs, obs)
        blocks = [
            _next_table(predict, self._params, _rows(now, at), obs[at : at + MOST_WORLDS])
            for at in range(0, len(obs), MOST_WORLDS)
        ]
        return jnp.concatenate(blocks), memory._replace(memory=now, obs=obs if memory.goes_on else None)


def _rows(memory: Memory, at: int) -> Memory:
    return jax.tree.map(lambda leaf: leaf[at : at + MOST_WORLDS], memory)


@partial(jax.jit, static_argnums=0)
def _remember(predict: Predict, params: Params, memory: Memory, before: jax.Array, obs: jax.Array) -> Memory:
    """The memory after a decision, which removed what was there before and is not there now."""
    rows = seen_rows(before)
    there, there_now = (parts(seen).rows[..., LENGTH_COLUMNS - 1] > 0 for seen in (before, obs))
    return predict(params, memory, rows, there & ~there_now)[1]


@partial(jax.jit, static_argnums=0)
def _next_table(predict: Predict, params: Params, memory: Memory, obs: jax.Array) -> jax.Array:
    """Observed tables (B, 108) 0.1 s later."""
    rows, _ = predict(params, memory, seen_rows(obs), jnp.zeros((len(obs), MAX_OBJECTS), bool))
    lengths = (rows[..., :LENGTH_COLUMNS] / SCREEN).clip(0.0, 1.0)
    present = lengths[..., -1:] > 0
    now = parts(obs).rows
    # Flags and pairs are those observed now: without a removal they stay.
    table = jnp.concatenate([lengths, now[..., LENGTH_COLUMNS:]], axis=-1)
    return jnp.where(present, table, 0.0).reshape(len(obs), -1)


def seen_rows(obs: jax.Array) -> jax.Array:
    """Tables (B, 12, 12) as world models read them, in px and px/s, from observations (B, D) with motion."""
    seen = parts(obs)
    velocity = seen.motion[:, : 3 * MAX_OBJECTS].reshape(len(obs), MAX_OBJECTS, 3)
    flags = seen.rows[..., LENGTH_COLUMNS:] > 0
    speed = velocity * jnp.array([[[SCREEN, SCREEN, 1.0]]])
    table = jnp.concatenate([seen.rows[..., :LENGTH_COLUMNS] * SCREEN, flags, speed], axis=-1)
    return jnp.where(seen.rows[..., LENGTH_COLUMNS - 1 : LENGTH_COLUMNS] > 0, table, 0.0)


def read_prediction(name: str) -> NamedPrediction:
    """The prediction of a world model of the package, or of a run folder.

    Raises:
        OSError, ValueError: one line; there is no such model, or its file cannot be read.
    """
    try:
        file = storage.named_file(name)
    except ValueError as error:
        expected = str(error).removeprefix("model: expected ")
        raise ValueError(f"prediction: expected {ZEROS}, {PERFECT}, {expected}") from None
    return NamedPrediction(lambda: WorldPrediction(storage.named_model(name)), file_sum(file))


offer_world_models(read_prediction)

"""What a prediction adds to an observation: the official table 0.1 s later if nothing is removed now.

"zeros" has the size and tells nothing; "perfect" is what the simulator says. They bound what any world model can give.
World models stand above this package and say by `offer_world_models` how one is read.

Shapes: B worlds, R = 108 numbers of a table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from iphyre_jax.checks import show
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.params import EnvParams, EnvState
from iphyre_jax.envs.strategies import OnTheFly
from iphyre_jax.observations.features import ROWS_SIZE
from iphyre_jax.scenes import Scene
from iphyre_jax.train.settings.run import PERFECT, ZEROS, TrainConfig


class Prediction(Protocol):
    """Predicts tables."""

    def start(self, scenes: Sequence[Scene], game: jax.Array, environment: Environment, params: EnvParams) -> Any:  # noqa: ANN401
        """What it keeps of B episodes that begin.

        Args:
            scenes: those played.
            game: (B,) int32 index of each episode's scene.
            environment: that plays them.
            params: of the environment.
        """

    def predict(self, memory: Any, obs: jax.Array, state: EnvState) -> tuple[jax.Array, Any]:  # noqa: ANN401
        """Predict tables before a decision.

        Args:
            memory: from `start` or the last prediction.
            obs: (B, D) observations with motion.
            state: of the episodes.

        Returns:
            Tables (B, R) float32 as observed, and the memory.
        """


class Zeros:
    """As many zeros as a prediction has numbers."""

    def start(self, scenes: Sequence[Scene], game: jax.Array, environment: Environment, params: EnvParams) -> None:
        """See `Prediction`; nothing is kept."""

    def predict(self, memory: None, obs: jax.Array, state: EnvState) -> tuple[jax.Array, None]:
        """See `Prediction`."""
        return jnp.zeros((len(obs), ROWS_SIZE), jnp.float32), memory


class Perfect:
    """What the simulator itself says."""

    def start(
        self, scenes: Sequence[Scene], game: jax.Array, environment: Environment, params: EnvParams
    ) -> tuple[Environment, EnvParams]:
        """See `Prediction`; an environment that can do nothing for 0.1 s is kept."""
        del game, params  # those of another strategy
        idle = replace(environment, strategy=OnTheFly(slots=environment.strategy.slots))
        return idle, idle.params(scenes)

    def predict(
        self, memory: tuple[Environment, EnvParams], obs: jax.Array, state: EnvState
    ) -> tuple[jax.Array, tuple[Environment, EnvParams]]:
        """See `Prediction`."""
        return _rows_later(memory[0], state, memory[1]), memory


@partial(jax.jit, static_argnums=0)
def _rows_later(environment: Environment, state: EnvState, params: EnvParams) -> jax.Array:
    """The tables of B episodes after 0.1 s in which nothing is removed."""
    nothing = jnp.zeros(state.game.shape, jnp.int32)
    keys = jax.random.split(jax.random.key(0), len(nothing))  # not used: nothing is reset
    step = jax.vmap(environment.step, in_axes=(0, 0, 0, None))
    return step(keys, state, nothing, params)[0][:, :ROWS_SIZE]


@dataclass(frozen=True)
class NamedPrediction:
    """How a prediction is made, and the SHA-256 sum of its parameters, which costs less."""

    open: Callable[[], Prediction]
    sha256: str = ""


Reader = Callable[[str], NamedPrediction]
_readers: list[Reader] = []


def offer_world_models(reader: Reader) -> None:
    """Say how a world model is read by its name.

    Args:
        reader: gives the prediction of a name; ValueError or OSError in one line if there is none.
    """
    _readers[:] = [reader]


def with_prediction_sum(config: TrainConfig) -> TrainConfig:
    """Return the settings with the SHA-256 sum of their world model; unchanged without one.

    Raises:
        OSError, ValueError: as `open_prediction`.
    """
    return replace(config, prediction_sha256=_named(config).sha256) if config.prediction else config


def open_prediction(config: TrainConfig) -> Prediction | None:
    """Return the prediction of a configuration, None without one.

    Raises:
        OSError, ValueError: one line; there is no such world model, or it is not the one that the settings name.
    """
    return _named(config).open() if config.prediction else None


def _named(config: TrainConfig) -> NamedPrediction:
    name = config.prediction
    if name in (ZEROS, PERFECT):
        return NamedPrediction(Zeros if name == ZEROS else Perfect)
    if not _readers:
        raise ValueError(f"prediction: {show(name)} needs `import iphyre_jax.models.world.prediction` first")
    found = _readers[0](name)
    if config.prediction_sha256 not in ("", found.sha256):
        raise ValueError(
            f"prediction: expected {name} with SHA-256 {config.prediction_sha256}, got {found.sha256}: it was changed"
        )
    return found


def first_predictions(config: TrainConfig, obs: jax.Array) -> jax.Array:
    """Observations (S, D) of starts, as networks of a configuration see them first, with a prediction (S, D + R).

    Networks take their mean for the centre. It is the table itself: in the first 0.1 s hardly anything moves.
    """
    if not config.prediction:
        return obs
    rows = obs[:, :ROWS_SIZE]
    return jnp.concatenate([obs, jnp.zeros_like(rows) if config.prediction == ZEROS else rows], axis=1)

"""Parts of an observation, by its size: the official one, with or without a no-op candidate, with or without motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.envs.strategies import STRATEGIES, StrategyName
from iphyre_jax.observations.features import MOTION_SIZE, ROWS_SIZE
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, Scene

SLOTS_SIZE: Final = 2 * MAX_ELIMINABLE

# Size of an observation -> where the candidates of the slots begin; on the fly the no-op's pair stands before them.
_CANDIDATES: Final[Mapping[int, int]] = MappingProxyType(
    {ROWS_SIZE + no_op + SLOTS_SIZE + motion: ROWS_SIZE + no_op for no_op in (0, 2) for motion in (0, MOTION_SIZE)}
)


class Parts(NamedTuple):
    """An observation taken apart."""

    rows: jax.Array  # (..., 12, 9) the official table
    candidates: jax.Array  # (..., 6, 2) centres of the slots' blocks at the start, 0 for a slot without one
    motion: jax.Array  # (..., 37) velocities and time, or (..., 0)


def parts(observation: jax.Array) -> Parts:
    """Take observations (..., D) apart."""
    start = _CANDIDATES[observation.shape[-1]]
    before = observation.shape[:-1]
    rows = observation[..., :ROWS_SIZE].reshape(*before, MAX_OBJECTS, -1)
    candidates = observation[..., start : start + SLOTS_SIZE].reshape(*before, MAX_ELIMINABLE, 2)
    return Parts(rows, candidates, observation[..., start + SLOTS_SIZE :])


def slot_mask(observation: jax.Array) -> jax.Array:
    """(..., 6) bool: the slots that stand for a block of the scene, removed or not."""
    return parts(observation).candidates.any(axis=-1)


def start_observations(strategy: StrategyName, observation: str, scenes: Sequence[str | Scene]) -> jax.Array:
    """(S, D) float32: what each of S scenes looks like to a strategy at the start; time and no-op are 0."""
    table = observation_table(scenes)
    rows, candidates = table[:, :ROWS_SIZE], table[:, ROWS_SIZE:]
    no_op = np.zeros((len(table), 2 if STRATEGIES[strategy].no_op_candidate else 0), np.float32)
    motion = np.zeros((len(table), MOTION_SIZE if observation == "motion" else 0), np.float32)
    return jnp.asarray(np.concatenate([rows, no_op, candidates, motion], axis=1))

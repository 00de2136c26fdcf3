"""The parts of an observation. Its size says whether it has a no-op candidate, motion and a predicted table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.checks import check_option
from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.envs.strategies import STRATEGIES, StrategyName
from iphyre_jax.observations.features import MOTION_SIZE, ROWS_SIZE
from iphyre_jax.observations.vectors import ObservationName, observation_size
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, Scene, load_scene
from iphyre_jax.scenes.limits import OFFICIAL

SLOTS_SIZE: Final = 2 * MAX_ELIMINABLE

# Size of an observation -> where the candidates of the slots begin; on the fly, after the pair of the no-op.
_CANDIDATES: Final[Mapping[int, int]] = MappingProxyType(
    {
        ROWS_SIZE + no_op + SLOTS_SIZE + motion + predicted: ROWS_SIZE + no_op
        for no_op, motion, predicted in product((0, 2), (0, MOTION_SIZE), (0, ROWS_SIZE))
    }
)


class Parts(NamedTuple):
    """The parts of an observation."""

    rows: jax.Array  # (..., 12, 9) the official table
    candidates: jax.Array  # (..., 6, 2) centres of the slots' blocks at the start, 0 for a slot without one
    motion: jax.Array  # (..., 37) velocities and time, or (..., 0)
    predicted: jax.Array  # (..., 108) a predicted table, or (..., 0)


def parts(obs: jax.Array) -> Parts:
    """Split observations (..., D) into their parts."""
    size = obs.shape[-1]
    start = _CANDIDATES[size]
    moves = start + SLOTS_SIZE  # where motion begins
    predicts = moves + (MOTION_SIZE if size - moves in (MOTION_SIZE, MOTION_SIZE + ROWS_SIZE) else 0)
    before = obs.shape[:-1]
    rows = obs[..., :ROWS_SIZE].reshape(*before, MAX_OBJECTS, -1)
    candidates = obs[..., start:moves].reshape(*before, MAX_ELIMINABLE, 2)
    return Parts(rows, candidates, obs[..., moves:predicts], obs[..., predicts:])


def observation_length(strategy: StrategyName, observation: ObservationName, has_prediction: bool = False) -> int:
    """The number of numbers in an observation."""
    candidates = MAX_ELIMINABLE + STRATEGIES[strategy].no_op_candidate
    return observation_size(observation, MAX_OBJECTS, candidates) + ROWS_SIZE * has_prediction


def slot_mask(obs: jax.Array) -> jax.Array:
    """(..., 6) bool: the slots that stand for a block of the scene, removed or not."""
    return filled_slots(parts(obs).candidates)


def filled_slots(candidates: jax.Array) -> jax.Array:
    """(..., 6) bool: the slots with a block, by the centres of the blocks (..., 6, 2), which come first.

    A centre in the corner of the picture is zero as that of a missing block is. A later block shows that it is there;
    nothing shows it of the last block.
    """
    return jax.lax.cummax(candidates.any(axis=-1).astype(jnp.int32), axis=candidates.ndim - 2, reverse=True) > 0


def start_observations(strategy: StrategyName, observation: str, scenes: Sequence[str | Scene]) -> jax.Array:
    """(S, D) float32: the first observation of each of S scenes under a strategy; time and no-op are 0.

    Raises:
        ValueError: another strategy or observation, or a scene that cannot be; one line.
    """
    check_option("strategy", strategy, tuple(STRATEGIES))
    check_option("observation", observation, ("official", "motion"))
    table = observation_table([load_scene(scene, OFFICIAL) for scene in scenes])
    rows, candidates = table[:, :ROWS_SIZE], table[:, ROWS_SIZE:]
    no_op = np.zeros((len(table), 2 if STRATEGIES[strategy].no_op_candidate else 0), np.float32)
    motion = np.zeros((len(table), MOTION_SIZE if observation == "motion" else 0), np.float32)
    return jax.device_put(np.concatenate([rows, no_op, candidates, motion], axis=1))

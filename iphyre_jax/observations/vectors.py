"""Observations as vectors in lanes; `images` draws pictures."""

from __future__ import annotations

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.observations.features import (
    Features,
    Pose,
    RowInputs,
    motion,
    motion_size,
    official_rows,
    row_inputs,
    rows_size,
    speeds,
)
from iphyre_jax.physics.types import Motion

ObservationName = Literal["official", "motion", "image"]


def observation_size(observation: ObservationName, objects: int, candidates: int) -> int:
    """Return the length of an observation from `observe`.

    Args:
        observation: see `observe`.
        objects: rows of the official table.
        candidates: pairs of numbers that follow.
    """
    size = rows_size(objects) + 2 * candidates
    return size + motion_size(objects) if observation == "motion" else size


class ObsInputs(NamedTuple):
    """What an observation needs of a world."""

    rows: RowInputs
    motion: jax.Array | None  # (37,) float32, see `features.motion`


def obs_inputs(
    observation: ObservationName, features: Features, pose: Pose, bodies: Motion, step: jax.Array, steps: jax.Array
) -> ObsInputs:
    """Return what `observe` needs of a world; lanes stand behind the numbers.

    Args:
        observation: "official", or "motion", which adds velocities and time; see `features`.
        features: of the scene.
        pose: of the world.
        bodies: velocities of the moving bodies; only "motion" needs them.
        step: () int32, steps made.
        steps: () physics steps of a whole episode, the unit of the time in "motion".
    """
    return ObsInputs(row_inputs(features, pose), motion_inputs(observation, features, pose, bodies, step, steps))


def motion_inputs(
    observation: ObservationName, features: Features, pose: Pose, bodies: Motion, step: jax.Array, steps: jax.Array
) -> jax.Array | None:
    """Return the part of `obs_inputs` that "motion" adds."""
    if observation != "motion":
        return None
    moved = motion(features, speeds(bodies), step, steps)
    return jnp.where(pose.sound[None], moved, jnp.zeros((), jnp.float32))  # no policy should meet a NaN


def observe(features: Features, inputs: ObsInputs, *, no_op: bool) -> jax.Array:
    """Return an observation of a world, float32; lanes stand behind the numbers.

    Args:
        features: of the scene.
        inputs: from `obs_inputs`.
        no_op: whether a candidate that does nothing, (0, 0), stands before those of the blocks.
    """
    lanes = inputs.rows.present.shape[1:]
    parts = [official_rows(features, inputs.rows)]
    if no_op:
        parts.append(jnp.zeros((2, *lanes), jnp.float32))
    parts.append(features.candidates.astype(jnp.float32).reshape(-1, *lanes))
    if inputs.motion is not None:
        parts.append(inputs.motion)
    return jnp.concatenate(parts)

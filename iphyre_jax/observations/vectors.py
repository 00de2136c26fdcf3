"""Observations as vectors in lanes; `images` draws pictures."""

from __future__ import annotations

from typing import Literal

import jax
import jax.numpy as jnp

from iphyre_jax.observations.features import Features, motion, motion_size, official_rows, pose_of, rows_size
from iphyre_jax.rollouts import EpisodeState

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


def observe(
    observation: ObservationName,
    features: Features,
    present: jax.Array,
    episode: EpisodeState,
    steps: jax.Array,
    *,
    no_op: bool,
) -> list[jax.Array]:
    """Return an observation of a world, float32, in parts to concatenate; lanes stand behind the numbers.

    Args:
        observation: "official", or "motion", which adds velocities and time; see `features`.
        features: of the scene.
        present: (slots,) bool, slots whose block is present.
        episode: of the world.
        steps: () physics steps of a whole episode, the unit of the time in "motion".
        no_op: whether a candidate that does nothing, (0, 0), stands before those of the blocks.
    """
    lanes = episode.state.step.shape
    parts = [official_rows(features, pose_of(features, present, episode))]
    if no_op:
        parts.append(jnp.zeros((2, *lanes), jnp.float32))
    parts.append(features.candidates.astype(jnp.float32).reshape(-1, *lanes))
    if observation == "motion":
        parts.append(motion(features, episode, steps))
    return parts

"""Pictures of scenes at their start, as the environments draw them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.observations.features import Features, Pose, scene_tables
from iphyre_jax.observations.images import image
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import topology_of


def start_pictures(scenes: Sequence[Scene], size: int) -> npt.NDArray[np.float32]:
    """Draw scenes before their first step, (S, size, size, 3) float32 from 0 to 1."""
    if not scenes:
        return np.zeros((0, size, size, 3), np.float32)
    # All are padded to the largest one, so that one program draws them.
    topologies = [topology_of(scene) for scene in scenes]
    features = [scene_tables(scene, topologies, "float32") for scene in scenes]
    table = jax.tree.map(lambda *leaves: np.stack(leaves), *features)
    return np.asarray(_draw(size, table, _start_poses(scenes, table)), np.float32) / np.float32(255)


def _start_poses(scenes: Sequence[Scene], features: Features) -> Pose:
    """The poses of scenes before their first step, one a row of every array."""
    position = np.zeros((*features.mover.shape, 2), np.float32)
    for row, mover, scene in zip(position, np.asarray(features.mover), scenes, strict=True):
        row[: (mover >= 0).sum()] = scene.centres[mover[mover >= 0]]
    present = np.asarray(features.obs_rows)[..., 4] > 0
    x, y = position[..., 0], position[..., 1]
    return Pose(x, y, np.zeros_like(x), present, np.ones(len(scenes), bool))  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=0)
def _draw(size: int, features: Features, poses: Pose) -> jax.Array:
    return jax.lax.map(lambda one: image(one[0], one[1], size), (features, poses))

"""The official observation of a scene, at the start or at any moment; host, NumPy.

It has twelve rows, one for each object in list order (blocks, then balls), of nine columns: x1, y1, x2, y2, radius,
eliminable, dynamic, joint, spring. Rows of removed and missing objects are zero; the others do not move up. The centres
of the eliminable blocks at the start follow, six pairs x, y that never change. A scene with larger `Limits` has more
rows and pairs. `observations.features` computes the same on a device.
Source: `IPHYRE.get_all_property` and `IPHYRE_inadvance.process` of the official package 0.2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import Scene

COLUMNS = 9
LENGTH_COLUMNS = 5  # x1, y1, x2, y2, radius: divided by the side of the screen
JOINT_COLUMN, SPRING_COLUMN = 7, 8

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class SceneFeatures:
    """The part of a scene's observations that never changes, padded to its limits, officially 12 and 6."""

    position: npt.NDArray[np.float64]  # (12, 2) px, centres at the start
    ends: npt.NDArray[np.float64]  # (12, 2, 2) px, end points minus centre at angle 0; zero for balls
    constants: npt.NDArray[np.float64]  # (12, 3) radius in px, eliminable, dynamic
    present: npt.NDArray[np.bool_]  # (12,) the scene has this object
    joints: npt.NDArray[np.bool_]  # (J, 12) row j: the two objects of joint j
    springs: npt.NDArray[np.bool_]  # (P, 12) row p: the two objects of spring p
    candidates: npt.NDArray[np.float32]  # (6, 2) centres of the eliminable blocks / 600, then zeros


def scene_features(scene: Scene) -> SceneFeatures:
    """Return the part of a scene's observations that never changes."""
    n_blocks, n_objects = scene.n_blocks, scene.n_objects
    size = scene.limits.objects
    position = np.zeros((size, 2))
    ends = np.zeros((size, 2, 2))
    constants = np.zeros((size, 3))
    position[:n_objects] = scene.centres
    ends[:n_blocks] = scene.blocks - position[:n_blocks, None]
    constants[:n_blocks, 0] = BAR_RADIUS
    constants[n_blocks:n_objects, 0] = scene.balls[:, 2]
    constants[:n_objects, 1] = scene.eliminable
    constants[:n_objects, 2] = scene.dynamic
    candidates = np.zeros((scene.limits.blocks, 2), np.float32)
    eliminable = list(scene.eliminable_blocks)
    places = position[eliminable].astype(np.float32) / np.float32(SCREEN)
    candidates[: len(eliminable)] = places.clip(0, 1)  # a block may lie outside the picture
    return SceneFeatures(
        position=position,
        ends=ends,
        constants=constants,
        present=np.arange(size) < n_objects,
        joints=_membership(scene.joints, size),
        springs=_membership(scene.springs, size),
        candidates=candidates,
    )


def _membership(pairs: Sequence[tuple[int, int]], size: int) -> npt.NDArray[np.bool_]:
    """Return which objects belong to each pair, (P, 12) bool."""
    member = np.zeros((len(pairs), size), bool)
    for row, pair in enumerate(pairs):
        member[row, list(pair)] = True
    return member


def object_rows(features: SceneFeatures, position: Floats, angle: Floats, alive: npt.NDArray[np.bool_]) -> Floats:
    """Return the official table of a world, or of many, (..., 12, 9), in px and before any scaling.

    Columns 7 and 8 hold the number of the last joint and of the last spring that an object belongs to, or 0. Numbers
    start at 1 and count the pairs that are left.

    Args:
        features: of the worlds' scene.
        position: (..., 12, 2) px, centres of the objects.
        angle: (..., 12) rad.
        alive: (..., 12) bool, False once removed.
    """
    present = alive & features.present
    cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
    ends = np.asarray(features.ends, position.dtype)
    x = position[..., :1] + ends[..., 0] * cos - ends[..., 1] * sin
    y = position[..., 1:] + ends[..., 0] * sin + ends[..., 1] * cos
    constants = np.asarray(features.constants, position.dtype)
    columns = [
        np.stack([x, y], axis=-1).reshape(*present.shape, 4),
        np.broadcast_to(constants, (*present.shape, constants.shape[1])),
        pair_number(features.joints, present).astype(position.dtype)[..., None],
        pair_number(features.springs, present).astype(position.dtype)[..., None],
    ]
    rows = np.concatenate(columns, axis=-1)
    return np.where(present[..., None], rows, np.zeros_like(rows))


def pair_number(member: npt.NDArray[np.bool_], present: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Return the number of each object's last remaining pair, (..., 12); a pair ends with either of its objects."""
    if not len(member):
        return np.zeros(present.shape, np.int32)
    remains = np.asarray(~(member & ~present[..., None, :]).any(axis=-1))
    number = np.cumsum(remains.astype(np.int32), axis=-1, dtype=np.int32)[..., None]
    return np.asarray(np.where(member & remains[..., None], number, np.zeros_like(number)).max(axis=-2))


def observation(
    features: SceneFeatures, position: Floats, angle: Floats, alive: npt.NDArray[np.bool_]
) -> npt.NDArray[np.float32]:
    """Return the observation of the in-advance environment, (120,) float32; arguments as in `object_rows`.

    Lengths are divided by 600 and everything is clipped to [0, 1]: pair numbers become flags, and an object that has
    left the screen sits at its edge. The candidates at the start follow.
    """
    rows = object_rows(features, position, angle, alive).astype(np.float32)
    scaled = np.concatenate([rows[:, :LENGTH_COLUMNS] / np.float32(SCREEN), rows[:, LENGTH_COLUMNS:]], axis=1)
    obs = np.clip(scaled, np.float32(0), np.float32(1))
    return np.concatenate([obs.reshape(-1), features.candidates.reshape(-1)])


def start_observation(scene: Scene) -> npt.NDArray[np.float32]:
    """Return the observation of a scene before its first step, (120,) float32."""
    features = scene_features(scene)
    return observation(features, features.position, np.zeros(len(features.present)), features.present)

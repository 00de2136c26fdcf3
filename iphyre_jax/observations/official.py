"""The official observation: what an agent sees of a scene, at the start or at any moment.

Twelve rows, one per object in list order (blocks, then balls), of nine columns
x1, y1, x2, y2, radius, eliminable, dynamic, joint, spring; rows of removed and missing objects are
zero and the others do not move up. Behind them the centres of the eliminable blocks at the start,
six pairs x, y, never updated. A scene of larger `Limits` has more rows and pairs.
Source: `IPHYRE.get_all_property` and `IPHYRE_inadvance.process` of the official package 0.2.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, Scene

COLUMNS = 9
LENGTH_COLUMNS = 5  # x1, y1, x2, y2, radius: divided by the side of the screen
SCREEN = 600.0  # px
BLOCK_RADIUS = 10.0  # px
OBSERVATION_SIZE = MAX_OBJECTS * COLUMNS + MAX_ELIMINABLE * 2

Array = Any  # a NumPy or a JAX array; the functions below work on either


@dataclass(frozen=True, eq=False)
class SceneFeatures:
    """What an observation needs of a scene and no step changes, padded to its limits, officially 12 and 6."""

    position: npt.NDArray[np.float64]  # (12, 2) px, centres at the start
    ends: npt.NDArray[np.float64]  # (12, 2, 2) px, end points minus centre at angle 0; zero for balls
    constants: npt.NDArray[np.float64]  # (12, 3) radius in px, eliminable, dynamic
    present: npt.NDArray[np.bool_]  # (12,) the scene has this object
    joints: npt.NDArray[np.bool_]  # (J, 12) row j: the two objects of joint j
    springs: npt.NDArray[np.bool_]  # (P, 12) row p: the two objects of spring p
    candidates: npt.NDArray[np.float32]  # (6, 2) centres of the eliminable blocks / 600, then zeros


def scene_features(scene: Scene) -> SceneFeatures:
    """Collect the unchanging part of a scene's observations (host, NumPy)."""
    n_blocks, n_objects = scene.n_blocks, scene.n_objects
    places = scene.limits.objects
    position = np.zeros((places, 2))
    ends = np.zeros((places, 2, 2))
    constants = np.zeros((places, 3))
    position[:n_blocks] = (scene.blocks[:, 0] + scene.blocks[:, 1]) / 2
    position[n_blocks:n_objects] = scene.balls[:, :2]
    ends[:n_blocks] = scene.blocks - position[:n_blocks, None]
    constants[:n_blocks, 0] = BLOCK_RADIUS
    constants[n_blocks:n_objects, 0] = scene.balls[:, 2]
    constants[:n_objects, 1] = scene.eliminable
    constants[:n_objects, 2] = scene.dynamic
    candidates = np.zeros((scene.limits.blocks, 2), np.float32)
    eliminable = list(scene.eliminable_blocks)
    candidates[: len(eliminable)] = position[eliminable].astype(np.float32) / np.float32(SCREEN)
    return SceneFeatures(
        position=position,
        ends=ends,
        constants=constants,
        present=np.arange(places) < n_objects,
        joints=_membership(scene.joints, places),
        springs=_membership(scene.springs, places),
        candidates=candidates,
    )


def _membership(pairs: Sequence[tuple[int, int]], places: int) -> npt.NDArray[np.bool_]:
    """(P, 12) bool, True where an object belongs to a pair."""
    member = np.zeros((len(pairs), places), bool)
    for row, pair in enumerate(pairs):
        member[row, list(pair)] = True
    return member


def object_rows(features: SceneFeatures, position: Array, angle: Array, alive: Array, xp: ModuleType = np) -> Array:
    """The official (12, 9) table of a world, in px and before any scaling.

    Args:
        features: of the world's scene.
        position: (12, 2) px, centres of the objects.
        angle: (12,) rad.
        alive: (12,) bool, False once removed.
        xp: the namespace to compute in, `numpy` or `jax.numpy`.

    Columns 7 and 8 hold the 1-based number, among the pairs that are left, of the last joint and
    the last spring that the object belongs to, or 0.
    """
    there = alive & features.present
    cos, sin = xp.cos(angle)[:, None], xp.sin(angle)[:, None]
    ends = xp.asarray(features.ends, position.dtype)
    x = position[:, 0][:, None] + ends[:, :, 0] * cos - ends[:, :, 1] * sin
    y = position[:, 1][:, None] + ends[:, :, 0] * sin + ends[:, :, 1] * cos
    columns = [
        xp.stack([x, y], axis=-1).reshape(-1, 4),
        xp.asarray(features.constants, position.dtype),
        pair_number(features.joints, there, xp).astype(position.dtype)[:, None],
        pair_number(features.springs, there, xp).astype(position.dtype)[:, None],
    ]
    rows = xp.concatenate(columns, axis=1)
    return xp.where(there[:, None], rows, xp.zeros_like(rows))


def pair_number(member: npt.NDArray[np.bool_], there: Array, xp: ModuleType) -> Array:
    """(12,) number of the last remaining pair an object belongs to; a pair ends with either of its objects."""
    if not len(member):
        return xp.zeros(there.shape, np.int32)
    remains = ~(member & ~there[None, :]).any(axis=1)
    number = xp.cumsum(remains.astype(np.int32))[:, None]
    return xp.where(member & remains[:, None], number, xp.zeros_like(number)).max(axis=0)


def observation(features: SceneFeatures, position: Array, angle: Array, alive: Array, xp: ModuleType = np) -> Array:
    """The (120,) float32 observation of the in-advance environment.

    Arguments as in `object_rows`. Lengths are divided by 600, then everything is clipped to
    [0, 1]: pair numbers become flags and what left the screen sits at its edge. The candidates
    follow, as they were at the start.
    """
    rows = object_rows(features, position, angle, alive, xp).astype(np.float32)
    scaled = xp.concatenate([rows[:, :LENGTH_COLUMNS] / np.float32(SCREEN), rows[:, LENGTH_COLUMNS:]], axis=1)
    obs = xp.clip(scaled, np.float32(0), np.float32(1))
    return xp.concatenate([obs.reshape(-1), xp.asarray(features.candidates).reshape(-1)])


def start_observation(scene: Scene) -> npt.NDArray[np.float32]:
    """The (120,) float32 observation of a scene before its first step."""
    features = scene_features(scene)
    obs = observation(features, features.position, np.zeros(len(features.present)), features.present)
    return np.asarray(obs, np.float32)


def candidate_mask(obs: Array, slots: int = MAX_ELIMINABLE) -> Array:
    """(..., slots) bool: the slots of an observation, (..., 120) for the official six, that stand for a block.

    A missing slot is the pair 0, 0; no eliminable block has its centre in the corner of the screen.
    """
    candidates = obs[..., -2 * slots :]
    return candidates.reshape(*obs.shape[:-1], slots, 2).any(axis=-1)

"""Sequences: the tables of a play, ten a second, built again from the poses of what moves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.observations.official import COLUMNS, object_rows, scene_features
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES, NEVER
from iphyre_jax.scenes import Scene

Tables = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def tables(dataset: Dataset, *, official: bool = True) -> Tables:
    """Return the tables of all plays, (N, 150, 12, 9) float64, px; `Dataset.select` first if they are many.

    They take 0.13 MB a play. From poses in float64 they equal those of the official class in a space of the same reset,
    bit for bit; from poses in float32 they differ by less than 1e-3 px. A scene with larger limits has more rows.

    Args:
        dataset: with sequences.
        official: as `collect_seq_data` saves them: frame k is taken after the removal that is due before step k fps/10,
            and frames from the solution on are zeros. False: as an agent sees them before it acts; the last pose
            repeats after the end.

    Raises:
        ValueError: the data set has no sequences; one line.
    """
    if dataset.poses is None:
        raise ValueError("dataset: expected one with sequences, as collect(..., sequences=True) makes it")
    size = dataset.scenes[0].limits.objects
    out = np.zeros((len(dataset), FRAMES, size, COLUMNS))
    starts = np.arange(FRAMES) * (dataset.fps // DECISIONS_PER_SECOND)
    for scene, rows in rows_by_scene(dataset):
        steps, end = dataset.steps[rows, : len(scene.eliminable_blocks)], dataset.end_step[rows]
        out[rows] = _scene_tables(scene, dataset.poses[rows], _present(scene, steps, end, starts, official))
        if official:
            out[rows] *= ~(dataset.success[rows, None] & (end[:, None] <= starts))[:, :, None, None]
    return out


def rows_by_scene(dataset: Dataset) -> Iterator[tuple[Scene, npt.NDArray[np.intp]]]:
    """Yield each scene that has plays, with their rows."""
    for index in np.unique(dataset.game).tolist():
        yield dataset.scenes[index], np.flatnonzero(dataset.game == index)


def _present(
    scene: Scene,
    steps: npt.NDArray[np.integer[Any]],
    end: npt.NDArray[np.integer[Any]],
    starts: npt.NDArray[np.integer[Any]],
    official: bool,
) -> Flags:
    """Return which objects are there in each frame, (B, 150, 12)."""
    present = np.zeros((len(steps), len(starts), scene.limits.objects), bool)
    present[:, :, : scene.n_objects] = True
    executed = (steps != NEVER) & (steps < end[:, None])
    latest = starts[None] if official else starts[None] - 1  # the last step before which a removal is visible
    for slot, block in enumerate(scene.eliminable_blocks):
        present[:, :, block] &= ~(executed[:, slot, None] & (steps[:, slot, None] <= latest))
    return present


def _scene_tables(scene: Scene, poses: npt.NDArray[np.floating[Any]], present: Flags) -> Tables:
    """Return the tables of one scene, (B, 150, 12, 9)."""
    features = scene_features(scene)
    movers = np.flatnonzero(scene.dynamic)
    position = np.broadcast_to(features.position, (*present.shape, 2)).copy()
    angle = np.zeros(present.shape)
    position[:, :, movers] = poses[:, :, : len(movers), :2]
    angle[:, :, movers] = poses[:, :, : len(movers), 2]
    return np.asarray(object_rows(features, position, angle, present), np.float64)

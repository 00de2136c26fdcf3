"""What an outcome classifier sees of a data set: tables of scenes and plans. Labels are a target and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.pictures import start_pictures
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.observations.official import LENGTH_COLUMNS, object_rows, scene_features
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import MAX_OBJECTS, Scene, load_scene
from iphyre_jax.scenes.limits import OFFICIAL

PICTURE: Final = 48  # px, side of a picture

Floats = npt.NDArray[np.float32]


class Scenes(NamedTuple):
    """S scenes at their start."""

    rows: jax.Array | Floats  # (S, 12, 9) the official table: lengths / 600, flags and pair numbers as they are
    pictures: jax.Array | Floats  # (S, P, P, 3) from 0 to 1, or (S, 0, 0, 3) without pictures


class Plans(NamedTuple):
    """N plans by object: what stands in a row belongs to the object of that row."""

    seconds: jax.Array | Floats  # (N, 12) time of the removal over the time scale, 0 for an object that stays
    removed: jax.Array | Floats  # (N, 12) 1 for an object that is removed


class Examples(NamedTuple):
    """N plays: the inputs, and the target."""

    game: jax.Array | npt.NDArray[np.int32]  # (N,) index of the scene
    plans: Plans
    label: jax.Array | npt.NDArray[np.int32]  # (N,) 1 if solved
    weight: jax.Array | Floats  # (N,) in the loss, 1 on average


def scene_rows(scenes: Sequence[Scene]) -> Floats:
    """The table of each scene at its start, (S, 12, 9); nothing is clipped. ValueError for one of more objects."""
    tables = np.zeros((len(scenes), MAX_OBJECTS, 9), np.float32)
    for table, scene in zip(tables, scenes, strict=True):
        features = scene_features(load_scene(scene, OFFICIAL))
        table[:] = object_rows(features, features.position, np.zeros(len(features.present)), features.present)
    tables[..., :LENGTH_COLUMNS] /= np.float32(SCREEN)
    return tables


def scene_inputs(scenes: Sequence[Scene], config: OutcomeConfig) -> Scenes:
    """What a network of these settings sees of scenes."""
    size = PICTURE if config.network == "vision" else 0
    pictures = start_pictures(scenes, size) if size else np.zeros((len(scenes), 0, 0, 3), np.float32)
    return Scenes(scene_rows(scenes), pictures)


def by_object(scenes: Sequence[Scene], game: npt.NDArray[np.int32], columns: Floats) -> Floats:
    """Numbers of the slots of plans, (N, 6), at the rows of their objects, (N, 12); 0 elsewhere."""
    slots = np.full((len(scenes), columns.shape[1]), MAX_OBJECTS)  # a slot without a block goes to a column to drop
    for row, scene in zip(slots, scenes, strict=True):
        row[: len(scene.eliminable_blocks)] = scene.eliminable_blocks
    placed = np.zeros((len(columns), MAX_OBJECTS + 1), np.float32)
    np.put_along_axis(placed, slots[game], columns, axis=1)
    return placed[:, :MAX_OBJECTS]


def plan_inputs(
    scenes: Sequence[Scene], game: npt.NDArray[np.int32], times: npt.NDArray[np.floating], config: OutcomeConfig
) -> Plans:
    """What a network of these settings sees of plans.

    Args:
        scenes: S scenes.
        game: (N,) index of each plan's scene.
        times: (N, 6) s; NaN is never, and so is 0 by the official rule.
        config: settings.
    """
    seconds = np.nan_to_num(np.asarray(times, np.float32), nan=0.0)
    removed = (seconds > 0).astype(np.float32)
    return Plans(
        by_object(scenes, game, seconds / np.float32(config.time_scale)),
        by_object(scenes, game, removed),
    )


def examples(dataset: Dataset, config: OutcomeConfig) -> Examples:
    """The plays of a data set as a network of these settings learns them."""
    times = np.where(dataset.steps < 0, np.float32("nan"), dataset.times)  # without what the rule leaves out
    if config.masked_times:
        end = dataset.end_step / float(dataset.manifest["fps"])
        times = np.where(times > end[:, None], np.float32("nan"), times)
    game = np.asarray(dataset.game, np.int32)
    label = np.asarray(dataset.success, np.int32)
    weight = class_weights(game, label) if config.equal_weights or config.draws else np.ones(len(game), np.float32)
    return Examples(game, plan_inputs(dataset.scenes, game, times, config), label, weight)


def class_weights(game: npt.NDArray[np.int32], label: npt.NDArray[np.int32]) -> Floats:
    """(N,) weights, 1 on average, that make every game and class count alike."""
    kind = 2 * game + label
    count = np.bincount(kind)
    return np.asarray(len(kind) / (np.count_nonzero(count) * count[kind]), np.float32)

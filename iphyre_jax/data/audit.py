"""Audits of data sets: are the labels true, and do two sets share a play?"""

from __future__ import annotations

import json
import os
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.arrays import check_shapes
from iphyre_jax.data.dataset import Dataset, scene_sum
from iphyre_jax.data.journal import Report, journal_in
from iphyre_jax.data.labels import FIRST_RESET, FRESH, PlayProtocol, label_plans, play_poses
from iphyre_jax.data.search import play_keys
from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import scene_to_dict

SHOWN: Final = 5  # rows that a line names
COLUMNS: Final = ("success", "end_step", "removals")


def verify(
    dataset: Dataset, *, journal: str | os.PathLike[str] | None = None, report: Report | None = None
) -> list[str]:
    """Play the stored steps again and compare the labels, and the poses if there are any, bit for bit.

    Args:
        dataset: to verify.
        journal: a folder for what is done so far; after a kill the same call goes on there.
        report: called with a line of progress.

    Returns:
        What differs, a line for each array; empty if everything was reproduced.

    Raises:
        ValueError: an array has another type or shape than such a data set has; one line.
    """
    manifest = dataset.manifest
    check_shapes(dataset.arrays(), dataset.scenes, manifest, "dataset")
    is_fresh = manifest["form"] == "fresh"
    protocol = PlayProtocol(dataset.fps, manifest["rule"], manifest["resets"] if is_fresh else FRESH)
    resets = None if is_fresh else dataset.draw.astype(np.int64) + FIRST_RESET
    different = _steps_without_times(dataset, protocol)
    with journal_in(journal, report) as opened:
        opened.report(f"playing {len(dataset)} plays again")
        labels = label_plans(dataset.scenes, dataset.game, dataset.steps, protocol, resets, opened)
        for name in COLUMNS:
            different += _difference(name, np.asarray(getattr(dataset, name) != getattr(labels, name)))
        if dataset.poses is not None:
            played = play_poses(dataset.scenes, dataset.game, dataset.steps, protocol, resets, opened)
            poses = np.full_like(dataset.poses, np.nan)  # a selection of scenes may have places that none of them needs
            poses[:, :, : played.shape[2]] = played
            same = _same_bits(poses, dataset.poses)
            different += _difference("poses", np.asarray(~same.all(axis=(1, 2, 3))))
    return different


def shared_plays(first: Dataset, second: Dataset) -> int:
    """Return how many plays of `first` are in `second` too.

    Two plays are the same if their scenes are and the same blocks go at the same steps before the end: a removal that
    was planned for later makes no other play of it.
    """
    others = set(_plays(second))
    return sum(play in others for play in _plays(first))


def repeated_plays(dataset: Dataset) -> int:
    """Return how many plays of a set are in it before."""
    return len(dataset) - len(set(_plays(dataset)))


def known_plays(dataset: Dataset) -> dict[str, set[bytes]]:
    """Return the plays of each scene, by the scene's SHA-256, as `play_keys` names them."""
    sums = [scene_sum(scene) for scene in dataset.scenes]
    known: dict[str, set[bytes]] = {}
    for index, key in zip(dataset.game.tolist(), play_keys(dataset.steps, dataset.end_step), strict=True):
        known.setdefault(sums[index], set()).add(key)
    return known


def _plays(dataset: Dataset) -> list[tuple[str, bytes]]:
    """Name plays by scene and removals, whatever the limits of the scenes: beside a larger one a scene has its."""
    contents = [scene_to_dict(scene) for scene in dataset.scenes]
    scenes = [json.dumps({**content, "limits": None}, sort_keys=True) for content in contents]
    own = [np.int16().itemsize * len(scene.eliminable_blocks) for scene in dataset.scenes]
    keys = play_keys(dataset.steps, dataset.end_step)
    return [(scenes[index], key[: own[index]]) for index, key in zip(dataset.game.tolist(), keys, strict=True)]


def _steps_without_times(dataset: Dataset, protocol: PlayProtocol) -> list[str]:
    """Compare steps with times: an entry takes its frame or, if others wait for the same, one of the next ones.

    The rule "in_advance" rounds times to tenths of a second, up or down.
    """
    late = dataset.steps / dataset.fps - dataset.times
    rounded = 1e-5 + (0.05 if protocol.rule == "in_advance" else 0.0)  # s; times are kept in float32
    waits = (dataset.steps.shape[1] + 1) / dataset.fps
    played = dataset.steps != NEVER
    wrong = played & ~((late > -rounded) & (late < waits + rounded))  # True where the time is NaN
    return _difference("steps", np.asarray(wrong.any(axis=1)))


def _difference(name: str, different: npt.NDArray[np.bool_]) -> list[str]:
    if not different.any():
        return []
    rows = np.flatnonzero(different)
    shown = ", ".join(map(str, rows[:SHOWN])) + (" ..." if len(rows) > SHOWN else "")
    return [f"{name}: {len(rows)} of {len(different)} plays differ (rows {shown})"]


def _same_bits(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
    return (first == second) | (np.isnan(first) & np.isnan(second))

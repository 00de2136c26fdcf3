"""Of plays: at which tenths of a second blocks went, which decisions that makes, what was seen and still to be won.

N plays, T decisions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.labels import PlayProtocol, play_poses
from iphyre_jax.data.sequences import tables
from iphyre_jax.models.sequence.networks import END, NEVER_BIN
from iphyre_jax.models.sequence.settings import EVENTS
from iphyre_jax.observations.official import LENGTH_COLUMNS, scene_features
from iphyre_jax.rules import DECISIONS_PER_SECOND, ELIMINATION_REWARD, FRAMES, SCREEN, SUCCESS_REWARD
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene

PART: Final = 512  # plays whose tables are made at once

Floats = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int32]
Bools = npt.NDArray[np.bool_]
Parts = tuple[Floats, Ints, Floats, Ints, Ints, Floats]
"""Tables, which is whose, returns, actions, tenths, weights: fields of `episodes.SequenceData`."""


def centres(scenes: Sequence[Scene]) -> Floats:
    """(S, 6, 2) centres of the slots' blocks / 600, 0 for a slot without one."""
    return np.stack([scene_features(scene).candidates for scene in scenes])


def slot_objects(scenes: Sequence[Scene]) -> Ints:
    """(S, 6) the object of each slot; END for a slot without one."""
    out = np.full((len(scenes), MAX_ELIMINABLE), END, np.int32)
    for row, scene in zip(out, scenes, strict=True):
        row[: len(scene.eliminable_blocks)] = scene.eliminable_blocks
    return out


def executed_bins(plays: Dataset) -> Ints:
    """(N, 6) tenths of a second at which each slot's block went, NEVER_BIN if it did not before the end."""
    done = (plays.steps >= 0) & (plays.steps < plays.end_step[:, None])
    bins = np.rint(np.nan_to_num(plays.times) * DECISIONS_PER_SECOND)
    return np.where(done, np.clip(bins, 0, FRAMES - 1), NEVER_BIN).astype(np.int32)


def rest(plays: Dataset, removed: Ints, time: Ints) -> Floats:
    """The rest of the reward / 1000 after some removals and tenths of a second, (N, T) each."""
    left = plays.end_step[:, None] / plays.fps - time / DECISIONS_PER_SECOND
    points = SUCCESS_REWARD * plays.success[:, None] + ELIMINATION_REWARD * (plays.removals[:, None] - removed)
    return np.asarray((points - np.maximum(left, 0.0)) / SUCCESS_REWARD, np.float32)


def with_poses(plays: Dataset, protocol: PlayProtocol) -> Dataset:
    """The same plays with their poses, ten a second."""
    return replace(plays, poses=play_poses(plays.scenes, plays.game, plays.steps, protocol).astype(np.float32))


def scaled(rows: npt.NDArray[np.floating]) -> Floats:
    """Tables in px as networks see them."""
    out = np.asarray(rows, np.float32)
    out[..., :LENGTH_COLUMNS] /= np.float32(SCREEN)
    return out


def tables_at(plays: Dataset, frames: Ints, *, official: bool = False) -> Floats:
    """(N, T, 12, 9) the tables of plays with poses at some tenths of a second (N, T)."""
    out = []
    for first in range(0, len(plays), PART):
        part = plays.select(np.arange(first, min(first + PART, len(plays))))
        here = np.clip(frames[first : first + PART], 0, FRAMES - 1)
        out.append(scaled(np.take_along_axis(tables(part, official=official), here[..., None, None], axis=1)))
    return np.concatenate(out)


def ordered(plays: Dataset) -> tuple[Ints, Ints, Ints]:
    """Slots in the order of their removal (N, 6), the tenths at which they go, and the number of removals (N,)."""
    bins = executed_bins(plays)
    done = np.where(bins == NEVER_BIN, np.iinfo(np.int16).max, plays.steps)
    order = np.argsort(done, axis=1, kind="stable").astype(np.int32)
    return order, np.take_along_axis(bins, order, axis=1), (bins != NEVER_BIN).sum(axis=1).astype(np.int32)


def decisions(plays: Dataset) -> tuple[Ints, Ints, Bools]:
    """Of decisions at the start and after each removal, (N, 7) each: removals before, tenths, whether they are made."""
    _, when, count = ordered(plays)
    before = np.broadcast_to(np.arange(EVENTS, dtype=np.int32), (len(plays), EVENTS))
    time = np.concatenate([np.zeros((len(plays), 1), np.int32), when], axis=1)
    made = before <= count[:, None]
    return before, np.where(made, time, 0), made


def seen_tables(plays: Dataset, before: Ints, time: Ints, made: Bools) -> tuple[Floats, Ints]:
    """Tables at decisions: the start, then the frame after each removal; and which is whose."""
    frames = np.where(before > 0, time + 1, 0)
    rows = tables_at(plays, frames)
    table = np.zeros(made.shape, np.int32)
    table[made] = np.arange(made.sum())
    return rows[made], table


def choices(plays: Dataset) -> tuple[Floats, Ints, Ints, Bools]:
    """Of all 150 decisions: tables (N 150, 12, 9), choices (N, 150, 1), tenths (N, 150), whether they are made."""
    frames = np.broadcast_to(np.arange(FRAMES, dtype=np.int32), (len(plays), FRAMES))
    rows = tables_at(plays, frames).reshape(-1, 12, 9)
    bins = executed_bins(plays)
    goes = bins[:, None] == frames[..., None]
    actions = np.where(goes.any(axis=-1), goes.argmax(axis=-1) + 1, 0).astype(np.int32)
    made = frames * (plays.fps // DECISIONS_PER_SECOND) < plays.end_step[:, None]
    return rows, actions[..., None], frames, made

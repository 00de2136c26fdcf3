"""Basic games, stretched, shifted, and then displaced object by object, many at once.

Unlike `iphyre_jax.scenes.vary` no drawn scene is refused: shifts stay in the picture, and a displacement that makes an
object overlap another one is drawn again, and at last left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from iphyre_jax.data.generated.canvas import BARS, FRAME, PLACES, Bools, Canvas, Ints
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.geometry import TOLERANCE, Floats

STRETCH: Final = (0.86, 1.1)  # factors of all positions; a scene whose objects then overlap keeps its size
SHIFT: Final = 100.0  # px, the largest shift of a whole game in each direction
JITTER: Final = (4.0, 30.0)  # px, the largest displacement of an object, drawn for each scene
TURN: Final = 0.5  # times that, by which the ends of a bar go further at most, one against the other
LOWEST: Final = 560.0  # px, y of the lowest object
TRIES: Final = 3


def displaced_games(games: Sequence[Scene], which: Ints, rng: np.random.Generator) -> Canvas:
    """Return n scenes; which: (n,) the game of each."""
    canvas = Canvas.empty(len(games))
    for row, game in enumerate(games):
        canvas.write(row, game)
    scenes = canvas.take(which)
    _move_whole(scenes, rng)
    amplitude = rng.uniform(*JITTER, len(which))
    for place in range(PLACES):
        rows: Ints = np.flatnonzero(scenes.used[:, place])
        for _ in range(TRIES):
            rows = _move_one(scenes, rows, place, amplitude, rng)
    return scenes


def _move_whole(scenes: Canvas, rng: np.random.Generator) -> None:
    """Stretch all scenes about the centre of the picture and shift them as far as they stay in it."""
    count, half = len(scenes.ends), SCREEN / 2
    factor = rng.uniform(*STRETCH, count)[:, None, None, None]
    stretched = np.round(half + (scenes.ends - half) * factor, 1)
    rows = np.flatnonzero(~_overlap_more(scenes, stretched))
    scenes.ends[rows] = stretched[rows]
    room = scenes.radii[:, :, None, None] + FRAME
    used = scenes.used[:, :, None, None]
    low = np.where(used, scenes.ends - room, np.inf).min(axis=(1, 2))
    high = np.where(used, scenes.ends + room, -np.inf).max(axis=(1, 2))
    least, largest = np.maximum(-low, -SHIFT), np.minimum(np.array([SCREEN, LOWEST]) - high, SHIFT)
    by = np.where(least <= largest, rng.uniform(0, 1, (count, 2)) * (largest - least) + least, 0.0)
    scenes.ends[...] = np.round(scenes.ends + np.round(by, 1)[:, None, None], 1)


def _overlap_more(scenes: Canvas, ends: Floats) -> Bools:
    """Return for each scene whether objects overlap more if they lie at other places, (B, PLACES, 2, 2) px."""
    rows = np.arange(len(ends))
    moved = replace(scenes, ends=ends)
    before, after = (one.gaps(rows, one.ends, one.radii) for one in (scenes, moved))
    worse = (after < np.minimum(before, 0.0) - TOLERANCE) & scenes.used[:, :, None]
    return np.asarray(worse.any(axis=(1, 2)))


def _move_one(scenes: Canvas, rows: Ints, place: int, amplitude: Floats, rng: np.random.Generator) -> Ints:
    """Displace the object at one place of some scenes; return those in which it then overlaps or has no length."""
    if not len(rows):
        return rows
    reach = amplitude[rows, None, None]
    moved = scenes.ends[rows, place] + rng.uniform(-1, 1, (len(rows), 1, 2)) * reach
    if place < BARS:
        turn = rng.uniform(-TURN, TURN, (len(rows), 1, 2)) * reach * np.array([1.0, 0.3])
        moved = moved + np.concatenate([-turn, turn], axis=1)
    moved = np.round(moved, 1)
    radii = scenes.radii[rows, place, None]
    both = np.stack([scenes.ends[rows, place], moved], axis=1)
    gaps = scenes.gaps(rows, both, np.repeat(radii, 2, axis=1))
    gaps[:, :, place] = np.inf
    before, after = gaps[:, 0], gaps[:, 1]
    room = radii[:, :, None] + FRAME
    inside = ((moved >= room) & (moved <= SCREEN - room)).all(axis=(1, 2))
    fine = inside & (after >= np.minimum(before, 0.0) - TOLERANCE).all(axis=1)
    if place < BARS:
        fine &= (moved[:, 0] != moved[:, 1]).any(axis=1)  # a short bar can be turned into a point
    scenes.ends[rows[fine], place] = moved[fine]
    return rows[~fine]

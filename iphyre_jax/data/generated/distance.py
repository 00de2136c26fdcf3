"""How far drawn scenes are from the games that nothing is trained on: all but the ten basic ones.

The distance of two scenes with equally many fixed, removable and moving bars and balls, whatever ties them: shift one
so that the mean ends of all objects agree, mirrored or not. Every object has a nearest one of its kind in the other
scene. The distance is the largest displacement, of ends, centres or radii, between an object of either scene and its
nearest one, in px.

It is a lower bound of the largest displacement under any matching after that shift, and at most twice that under the
best shift. So whoever refuses all below D refuses all that differ from a game by less than D / 2 px an object.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.generated.canvas import BALLS, BARS, Canvas, Ints
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.scenes.geometry import Floats

NEAREST: Final = 30.0  # px; a drawn scene that is nearer to a test game is refused
TEST_SPLITS: Final = ("noisy", "compositional", "multi_ball", "unseen_basic")
KINDS: Final = 5  # fixed, removable and moving bars, balls, nothing; joints and springs do not count


def distances_to_test_games(scenes: Canvas) -> Floats:
    """Return the distance of each scene to the nearest test game, (B,) px; inf if no game has the same kinds."""
    kinds, nearest = _kinds(scenes), np.full(len(scenes.ends), np.inf)
    counts = _counts(kinds)
    games = _test_games()
    game_kinds = _kinds(games)
    for game, wanted in enumerate(_counts(game_kinds)):
        rows = np.flatnonzero((counts == wanted).all(axis=1))
        if len(rows):
            one = games.take(np.array([game]))
            found = distances(scenes.take(rows), kinds[rows], one, game_kinds[game : game + 1])
            nearest[rows] = np.minimum(nearest[rows], found)
    return nearest


def distances(scenes: Canvas, kinds: Ints, game: Canvas, game_kinds: Ints) -> Floats:
    """Return the distances of B scenes to one with equally many objects of each kind, (B,) px.

    Args:
        scenes: B scenes.
        kinds: (B, PLACES) of their objects.
        game: one scene.
        game_kinds: (1, PLACES) of its objects.
    """
    alike = (kinds[:, :, None] == game_kinds[:, None]) & scenes.used[:, :, None] & game.used[:, None]
    radii = np.abs(scenes.radii[:, :, None] - game.radii[:, None])
    mirrored = game.take(np.array([0]))
    mirrored.mirror(np.array([0]))
    best = np.full(len(kinds), np.inf)
    for other in (game, mirrored):
        own, its = _centred(scenes)[:, :, None], _centred(other)[:, None]
        straight = _length(own - its).max(axis=-1)
        turned = _length(own - its[..., ::-1, :]).max(axis=-1)
        apart = np.where(alike, np.maximum(np.minimum(straight, turned), radii), np.inf)
        there = np.where(scenes.used, apart.min(axis=2), 0.0).max(axis=1)
        back = np.where(game.used, apart.min(axis=1), 0.0).max(axis=1)
        best = np.minimum(best, np.maximum(there, back))
    return best


def _length(ways: Floats) -> Floats:
    return np.asarray(np.hypot(ways[..., 0], ways[..., 1]))


def _centred(scenes: Canvas) -> Floats:
    """Return the ends of all objects about their mean, (B, PLACES, 2, 2) px."""
    weight = scenes.used[:, :, None, None]
    mean = (scenes.ends * weight).sum(axis=(1, 2), keepdims=True) / (2 * weight.sum(axis=(1, 2), keepdims=True))
    return np.asarray(scenes.ends - mean)


def _kinds(scenes: Canvas) -> Ints:
    """Return what each object is, (B, PLACES), a number below KINDS."""
    bars = np.where(scenes.moving[:, :BARS], 2, scenes.eliminable[:, :BARS].astype(int))
    kinds = np.concatenate([bars, np.full(scenes.link.shape, 3)], axis=1)
    return np.where(scenes.used, kinds, KINDS - 1)


def _counts(kinds: Ints) -> npt.NDArray[np.int64]:
    """Return how many objects of each kind the scenes have, (B, KINDS)."""
    return np.asarray((kinds[:, :, None] == np.arange(KINDS)).sum(axis=1))


@cache
def _test_games() -> Canvas:
    """Return the test games that a canvas has room for; no drawn scene has as many objects as the others."""
    names = [name for split in TEST_SPLITS for name in SPLITS[split]]
    games = [game for game in map(load_scene, names) if game.n_blocks <= BARS and game.n_balls <= BALLS]
    canvas = Canvas.empty(len(games))
    for row, game in enumerate(games):
        canvas.write(row, game)
    return canvas

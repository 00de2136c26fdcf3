"""Drawing unions: scenes with the objects of two basic games, some bars of each left out.

Numbers were not tuned.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from iphyre_jax.data.generated.canvas import BARS, PIN, SPRING, Bools, Canvas, Element, Ints, Propose, place
from iphyre_jax.data.generated.displaced import displaced_games
from iphyre_jax.scenes import SPLITS, Scene, load_scene

STAYS: Final = 0.75  # chance that a bar of a game is there; what moves or is tied always is
FREE_BALL: Final = 0.6  # chance that the ball of the second game is there, if nothing ties it
SETS: Final = 4  # of bars that are there, for each game in a chunk: their scenes are placed together


def draw_unions(count: int, rng: np.random.Generator) -> tuple[Canvas, Bools, Ints]:
    """Draw scenes of two basic games each.

    Returns:
        The scenes; whether each is whole; and the index of its first game, each (count,).
    """
    canvas, whole = Canvas.empty(count), np.ones(count, bool)
    games = [load_scene(name) for name in SPLITS["basic"]]
    pairs = rng.integers(len(games), size=(2, count))
    for second, which in enumerate(pairs):
        for number, game in enumerate(games):
            rows = np.flatnonzero((which == number) & whole)
            for some in np.array_split(rng.permutation(rows), SETS):
                whole[place(canvas, rng, some, _part(game, rng, free_ball=not second))] = False
    return canvas, whole, pairs[0]


def _part(game: Scene, rng: np.random.Generator, *, free_ball: bool) -> Propose:
    """Return what proposes a basic game without some of its bars.

    Args:
        game: with one ball, tied to at most one bar.
        rng: draws which bars are there.
        free_ball: whether the ball is there for sure.
    """
    link, anchors = next(
        ((kind, [pairs[0][0]]) for kind, pairs in ((PIN, game.joints), (SPRING, game.springs)) if pairs), (0, [])
    )
    ball = free_ball or bool(anchors) or rng.random() < FREE_BALL
    stays = game.dynamic[: game.n_blocks] | (rng.random(game.n_blocks) < STAYS)
    bars = [*anchors, *(k for k in np.flatnonzero(stays).tolist() if k not in anchors)]

    def propose(rng: np.random.Generator, n: int) -> Element:
        drawn = displaced_games([game], np.zeros(n, int), rng)
        centre = np.concatenate([drawn.ends[:, BARS, 0], drawn.radii[:, BARS, None]], axis=1)
        moving = tuple(game.dynamic[bars].tolist())
        return Element(drawn.ends[:, bars], drawn.eliminable[:, bars], moving, centre if ball else None, link)

    return propose

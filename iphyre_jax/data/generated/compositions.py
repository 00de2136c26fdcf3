"""Drawing scenes of elements: compositions, and basic games that are moved about and get further elements.

Weights were chosen by the filter alone: what often gives hard scenes is drawn more often.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from iphyre_jax.data.generated import elements
from iphyre_jax.data.generated.canvas import PIN, SPRING, Bools, Canvas, Ints, Propose, place
from iphyre_jax.data.generated.displaced import displaced_games
from iphyre_jax.scenes import SPLITS, load_scene

COMPOSED: Final = 0.5  # share of the scenes that are compositions; the others begin with a basic game

MOVERS: Final[tuple[tuple[tuple[str, ...], float], ...]] = (  # what moves in a composition, and its weight
    (("ball",), 0.5),
    (("pendulum",), 1),
    (("spring",), 0.5),
    (("loose", "ball"), 1),
    (("table",), 1.5),
    (("table", "loose"), 1.5),
    (("table", "ball"), 1.5),
    (("loose", "pendulum"), 0.5),
    (("loose", "spring"), 0.5),
    (("loose", "loose", "ball"), 1),
    (("ball", "ball"), 1),
    (("loose", "ball", "ball"), 1.5),
    (("pendulum", "ball"), 2),
    (("spring", "ball"), 2),
    (("pendulum", "pendulum"), 1.5),
    (("spring", "spring"), 0.5),
    (("pendulum", "spring"), 2.5),
    (("ball", "ball", "ball"), 2),
)
BASIC: Final = (0.5, 1, 1, 1, 4, 0.2, 4, 2, 1, 1)  # weights of the basic games, in the order of their split
EXTRAS: Final[tuple[tuple[str, ...], ...]] = ((), (), ("ball",), ("loose",))  # what a basic game gets that moves
HOLDERS: Final[tuple[tuple[Propose, float], ...]] = (
    (elements.hold, 3),
    (elements.two_holds, 1),
    (elements.slope, 2),
    (elements.wedge, 2),
    (elements.vee, 2),
    (elements.resting_ball, 1),
)
FLOORS: Final[tuple[tuple[Propose, float], ...]] = (
    (elements.floor_with_stops, 3),
    (elements.floor_with_hole, 3),
    (elements.walled_floor, 3),
    (elements.low_slope, 1),
    (elements.shelf, 1),
)
OF: Final[dict[str, tuple[tuple[Propose, float], ...]]] = {
    "ball": HOLDERS,
    "table": ((elements.table, 1),),
    "pendulum": ((partial(elements.tied, link=PIN), 1),),
    "spring": ((partial(elements.tied, link=SPRING), 1),),
    "loose": ((elements.loose_on_hold, 2), (elements.loose_on_pegs, 2)),
}


def draw_compositions(count: int, rng: np.random.Generator) -> tuple[Canvas, Bools, Ints]:
    """Draw scenes.

    Returns:
        The scenes; whether each is whole; and the index of the basic game that it began with, -1 for a composition of
        elements alone; each (count,).
    """
    canvas, whole = Canvas.empty(count), np.ones(count, bool)
    basic = np.where(rng.random(count) < COMPOSED, -1, _weighted(rng, BASIC, count))
    composed, begun = np.flatnonzero(basic < 0), np.flatnonzero(basic >= 0)
    canvas.set(begun, displaced_games([load_scene(name) for name in SPLITS["basic"]], basic[begun], rng))
    movers = _weighted(rng, [weight for _, weight in MOVERS], count)
    extras = rng.integers(len(EXTRAS), size=count)
    whole[_place_some(canvas, rng, composed, FLOORS)] = False
    for kinds, options, rows in ((movers, [names for names, _ in MOVERS], composed), (extras, EXTRAS, begun)):
        for which, names in enumerate(options):
            for name in names:
                mine = rows[(kinds[rows] == which) & whole[rows]]
                whole[_place_some(canvas, rng, mine, OF[name])] = False
    _decorate(canvas, rng, composed, begun)
    return canvas, whole, basic


def _decorate(canvas: Canvas, rng: np.random.Generator, composed: Ints, begun: Ints) -> None:
    """Add a second floor to half of the compositions, and distractors; what finds no place is left out."""
    _place_some(canvas, rng, composed[rng.random(len(composed)) < 0.5], FLOORS, tries=4)
    for rows, chance in ((composed, 0.8), (composed, 0.6), (composed, 0.4), (begun, 0.6), (begun, 0.4)):
        place(canvas, rng, rows[rng.random(len(rows)) < chance], elements.distractor, tries=4)


def _place_some(
    canvas: Canvas,
    rng: np.random.Generator,
    rows: Ints,
    options: tuple[tuple[Propose, float], ...],
    tries: int = 8,
) -> Ints:
    """Put one of several elements into each scene, by their weights; return the scenes that got none."""
    which = _weighted(rng, [weight for _, weight in options], len(rows))
    left = [place(canvas, rng, rows[which == k], option, tries) for k, (option, _) in enumerate(options)]
    return np.concatenate(left)


def _weighted(rng: np.random.Generator, weights: Sequence[float], count: int) -> Ints:
    """Draw `count` indices by their weights."""
    return np.asarray(rng.choice(len(weights), size=count, p=np.array(weights) / sum(weights)))

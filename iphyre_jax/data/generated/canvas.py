"""B scenes under construction as arrays: elements are proposed for many scenes at once and put where they fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, Scene
from iphyre_jax.scenes.compile import STATIC_ROOM
from iphyre_jax.scenes.geometry import Floats, gaps_between

BARS: Final = MAX_OBJECTS - 1  # places of bars; those of balls come behind
BALLS: Final = 3
PLACES: Final = BARS + BALLS
FREE, PIN, SPRING = 0, 1, 2  # what ties a ball to a bar
GAP: Final = 2.0  # px between an element and what is there
FRAME: Final = 2.0  # px between an object and the frame of the picture

Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.integer[Any]]


class Element(NamedTuple):
    """Objects that belong together, proposed for n scenes: k bars, then at most one ball."""

    bars: Floats  # (n, k, 2, 2) px, end points
    eliminable: Bools  # (n, k)
    moving: tuple[bool, ...] = ()  # of each bar; none moves by default
    ball: Floats | None = None  # (n, 3) px, x, y and radius
    link: int = FREE  # what ties the ball to the first bar


@dataclass(frozen=True)
class Canvas:
    """B scenes. An object that is not there lies far away; bars and balls fill their places in order.

    Attributes:
        ends: (B, PLACES, 2, 2) px, the ends of the objects' segments; both ends of a ball are its centre.
        radii: (B, PLACES) px.
        used: (B, PLACES) bool, whether an object is there.
        eliminable: (B, PLACES) bool.
        moving: (B, PLACES) bool.
        link: (B, BALLS) int8, FREE, PIN or SPRING.
        anchor: (B, BALLS) int8, the bar that a ball is tied to.
    """

    ends: Floats
    radii: Floats
    used: Bools
    eliminable: Bools
    moving: Bools
    link: npt.NDArray[np.int8]
    anchor: npt.NDArray[np.int8]

    @classmethod
    def empty(cls, count: int) -> Canvas:
        """Return `count` scenes without objects."""
        radii = np.full((count, PLACES), BAR_RADIUS)
        flags = [np.zeros((count, PLACES), bool) for _ in range(3)]
        links = [np.zeros((count, BALLS), np.int8) for _ in range(2)]
        return cls(np.zeros((count, PLACES, 2, 2)), radii, *flags, *links)

    @property
    def bars(self) -> Ints:
        """The number of bars of each scene, (B,)."""
        return np.asarray(self.used[:, :BARS].sum(axis=1))

    @property
    def balls(self) -> Ints:
        """The number of balls of each scene, (B,)."""
        return np.asarray(self.used[:, BARS:].sum(axis=1))

    def take(self, rows: npt.NDArray[Any]) -> Canvas:
        """Return some of the scenes; rows: indices or a mask."""
        return Canvas(*(array[rows] for array in vars(self).values()))

    def set(self, rows: npt.NDArray[Any], scenes: Canvas) -> None:
        """Put scenes in the place of some."""
        for mine, given in zip(vars(self).values(), vars(scenes).values(), strict=True):
            mine[rows] = given

    def write(self, row: int, game: Scene) -> None:
        """Put a scene of at most BARS bars and BALLS balls into an empty row; of links those of a bar to a ball."""
        bars, balls = game.n_blocks, game.n_balls
        places = np.r_[:bars, BARS : BARS + balls]
        self.ends[row, :bars], self.ends[row, BARS : BARS + balls] = game.blocks, game.balls[:, None, :2]
        self.radii[row, BARS : BARS + balls] = game.balls[:, 2]
        self.used[row, places] = True
        self.eliminable[row, places], self.moving[row, places] = game.eliminable, game.dynamic
        for kind, pairs in ((PIN, game.joints), (SPRING, game.springs)):
            for bar, ball in (pair for pair in pairs if pair[0] < bars <= pair[1]):
                self.link[row, ball - bars], self.anchor[row, ball - bars] = kind, bar

    def mirror(self, rows: npt.NDArray[Any]) -> None:
        """Mirror some of the scenes, left and right; rows: indices or a mask."""
        mirrored = self.ends[rows]
        mirrored[..., 0] = np.round(SCREEN - mirrored[..., 0], 1)
        self.ends[rows] = mirrored

    def gaps(self, rows: Ints, ends: Floats, radii: Floats) -> Floats:
        """Return the gaps between k objects, (n, k, 2, 2) px, and those of n scenes, (n, k, PLACES); inf without."""
        most = int(self.bars[rows].max(initial=0))
        places = np.r_[:most, BARS:PLACES]
        found = np.full((*radii.shape, PLACES), np.inf)
        apart = gaps_between(ends, radii, self.ends[rows][:, places], self.radii[rows][:, places])
        found[..., places] = np.where(self.used[rows][:, None, places], apart, np.inf)
        return found

    def scene(self, row: int, name: str) -> Scene:
        """Return a scene, its fields checked."""
        return scene_of(
            name,
            self.ends[row, :BARS][self.used[row, :BARS]],
            np.concatenate([self.ends[row, BARS:, 0], self.radii[row, BARS:, None]], axis=1)[self.used[row, BARS:]],
            self.eliminable[row, :BARS],
            self.moving[row, :BARS],
            self.link[row],
            self.anchor[row],
        )


def scene_of(
    name: str, bars: Floats, balls: Floats, eliminable: Bools, moving: Bools, link: Ints, anchor: Ints
) -> Scene:
    """Return a scene of n bars, (n, 2, 2) px, and m balls, (m, 3) px; flags and links beyond them are ignored."""
    n, m = len(bars), len(balls)

    def tied(kind: int) -> tuple[tuple[int, int], ...]:
        return tuple((int(anchor[k]), n + k) for k in range(m) if link[k] == kind)

    return Scene(
        name=name,
        blocks=bars,
        balls=balls,
        eliminable=np.concatenate([eliminable[:n], np.zeros(m, bool)]),
        dynamic=np.concatenate([moving[:n], np.ones(m, bool)]),
        joints=tied(PIN),
        springs=tied(SPRING),
    )


Propose = Callable[[np.random.Generator, int], Element]


def place(canvas: Canvas, rng: np.random.Generator, rows: Ints, propose: Propose, tries: int = 8) -> Ints:
    """Put an element into some of the scenes; each is proposed anew where it does not fit.

    Args:
        canvas: gets the elements.
        rng: of the proposals.
        rows: (n,) the scenes.
        propose: draws the element for so many scenes.
        tries: proposals for each scene at most.

    Returns:
        The scenes that got none.
    """
    for _ in range(tries):
        if not len(rows):
            break
        element = _rounded(propose(rng, len(rows)))
        fits = _has_room(canvas, rows, element) & _is_free(canvas, rows, element)
        _put(canvas, rows[fits], element, fits)
        rows = rows[~fits]
    return rows


def _rounded(element: Element) -> Element:
    """Return an element in tenths of a px, so that its numbers are short in a file."""
    ball = None if element.ball is None else np.round(element.ball, 1)
    return element._replace(bars=np.round(element.bars, 1), ball=ball)


def _segments(element: Element) -> tuple[Floats, Floats]:
    """Return ends, (n, K, 2, 2) px, and radii, (n, K) px, of an element's objects."""
    radii = np.full(element.bars.shape[:2], BAR_RADIUS)
    if element.ball is None:
        return element.bars, radii
    centre = np.repeat(element.ball[:, None, None, :2], 2, axis=2)
    return np.concatenate([element.bars, centre], axis=1), np.concatenate([radii, element.ball[:, 2:]], axis=1)


def _has_room(canvas: Canvas, rows: Ints, element: Element) -> Bools:
    """Return whether so many objects may join each scene."""
    bars, balls = element.bars.shape[1], int(element.ball is not None)
    statics = (canvas.used & ~canvas.moving)[rows, :BARS].sum(axis=1) + bars - sum(element.moving)
    removable = canvas.eliminable[rows].sum(axis=1) + element.eliminable.sum(axis=1)
    objects = canvas.used[rows].sum(axis=1) + bars + balls
    return np.asarray(
        (objects <= MAX_OBJECTS)
        & (removable <= MAX_ELIMINABLE)
        & (statics <= STATIC_ROOM)
        & (canvas.balls[rows] + balls <= BALLS)
    )


def _is_free(canvas: Canvas, rows: Ints, element: Element) -> Bools:
    """Return whether an element lies in the picture, off what is there, and none of its objects on another."""
    ends, radii = _segments(element)
    room = radii[:, :, None, None] + FRAME
    inside = ((ends >= room) & (ends <= SCREEN - room)).all(axis=(1, 2, 3))
    free = np.zeros(len(rows), bool)
    ends, radii = ends[inside], radii[inside]
    own = gaps_between(ends, radii, ends, radii)[:, *np.triu_indices(radii.shape[1], k=1)]
    free[inside] = (own >= 0).all(axis=1) & (canvas.gaps(rows[inside], ends, radii) >= GAP).all(axis=(1, 2))
    return free


def _put(canvas: Canvas, rows: Ints, element: Element, chosen: Bools) -> None:
    """Write an element into scenes at their next free places."""
    first, balls = canvas.bars[rows], canvas.balls[rows]
    for k in range(element.bars.shape[1]):
        place = first + k
        canvas.ends[rows, place], canvas.used[rows, place] = element.bars[chosen, k], True
        canvas.eliminable[rows, place] = element.eliminable[chosen, k]
        canvas.moving[rows, place] = element.moving[k] if element.moving else False
    if element.ball is not None:
        place = BARS + balls
        canvas.ends[rows, place] = element.ball[chosen, None, :2]
        canvas.radii[rows, place], canvas.used[rows, place] = element.ball[chosen, 2], True
        canvas.moving[rows, place] = True
        canvas.link[rows, balls], canvas.anchor[rows, balls] = element.link, first

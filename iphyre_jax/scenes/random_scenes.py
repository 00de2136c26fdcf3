"""Random valid scenes of a few topologies, for searches after what no hand-made scene shows.

A `Kind` says what moves and what ties it; `KINDS` are those of the benchmark's games and others that have every sort
of joint, spring and contact. `random_scene` fills one with objects. Every scene of a kind has the same topology, so
however many scenes are drawn, no more programs are compiled than there are kinds.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np

from iphyre_jax.scenes.geometry import BAR_RADIUS, FRAME, TOLERANCE, Layouts, gaps
from iphyre_jax.scenes.limits import MAX_ELIMINABLE, MAX_OBJECTS
from iphyre_jax.scenes.schema import Scene

HELD: Final = -1  # the end of a joint or spring at a static bar
MAX_STATICS: Final = 10  # more static bars are another topology

Pairs = tuple[tuple[int, int], ...]
Start = Literal["scattered", "touching", "stacked", "symmetric", "overlapping"]
STARTS: Final[tuple[Start, ...]] = ("scattered", "touching", "stacked", "symmetric", "overlapping")

_MIDDLE: Final = FRAME / 2
_LIFT: Final = 37.0  # px, by which an object that finds no room goes up
_LENGTHS: Final = (0.01, 500.0)  # px, of bars
_RADII: Final = (5, 35)  # px, of balls
_TRIES: Final = 20


@dataclass(frozen=True)
class Kind:
    """What moves in a scene, and what ties it: moving bars count from 0, balls after them.

    Attributes:
        bars: moving bars.
        balls: balls, at least one.
        joints: moving bodies, or HELD, at the ends of each pin joint.
        springs: of each spring.
    """

    bars: int
    balls: int
    joints: Pairs = ()
    springs: Pairs = ()

    @property
    def moving(self) -> int:
        """Number of moving bodies."""
        return self.bars + self.balls

    @property
    def least_statics(self) -> int:
        """Static bars without which a pair would recur: as many as one body has links of one sort to static bars."""
        held = [Counter(b if a == HELD else a for a, b in pairs if HELD in (a, b)) for pairs in self.links]
        return max((n for counter in held for n in counter.values()), default=0)

    @property
    def links(self) -> tuple[Pairs, Pairs]:
        """Joints and springs."""
        return self.joints, self.springs


KINDS: Final[tuple[Kind, ...]] = (
    # those of the forty games
    Kind(0, 1),
    Kind(1, 1),
    Kind(0, 1, joints=((HELD, 0),)),
    Kind(0, 1, springs=((HELD, 0),)),
    Kind(2, 1),
    Kind(1, 1, springs=((0, 1),)),
    Kind(1, 1, joints=((0, 1),)),
    Kind(2, 1, joints=((HELD, 2),)),
    Kind(1, 1, springs=((HELD, 0),)),
    Kind(0, 6),
    Kind(0, 2),
    Kind(1, 2),
    Kind(3, 2),
    Kind(0, 2, joints=((HELD, 0), (HELD, 1))),
    Kind(0, 2, springs=((HELD, 0), (HELD, 1))),
    Kind(1, 2, springs=((HELD, 0),)),
    # the sorts of links that no game has, chains and nets of them, and the most moving bars
    Kind(0, 3, joints=((0, 1),), springs=((1, 2),)),
    Kind(2, 1, joints=((0, 1),)),
    Kind(2, 1, springs=((0, 1),)),
    Kind(1, 1, joints=((HELD, 0),)),
    Kind(2, 2, joints=((HELD, 0), (0, 1), (1, 2)), springs=((2, 3), (HELD, 3))),
    Kind(1, 3, joints=((0, 1), (2, 0)), springs=((3, HELD), (0, 3))),
    Kind(3, 3),
    Kind(5, 1),
)


def random_scene(
    rng: np.random.Generator, kind: Kind, start: Start = "scattered", *, fast: bool = False, name: str = "random"
) -> Scene:
    """Draw a valid scene.

    Bars have all lengths and angles, often upright or level. An eliminable bar carries at most one joint or spring, for
    the reference renumbers its lists when one goes. Objects that find no room are above the picture.

    Args:
        rng: the source of all choices.
        kind: what moves, of `KINDS` or another of at most twelve bodies.
        start: "scattered", nothing overlaps; "touching", moving bodies rest exactly on others, on whole px; "stacked",
            they form one exact pile; "symmetric", the picture is its own mirror image but for links and flags;
            "overlapping", anything may overlap anything.
        fast: lift the balls by up to 5000 px, so that they come down at up to 1000 px/s.
        name: of the scene.
    """
    most = min(MAX_STATICS, MAX_OBJECTS - kind.moving)
    statics = int(rng.integers(max(kind.least_statics, start == "stacked"), most + 1))
    layout = _Layout(rng, overlap=start == "overlapping")
    _ARRANGE[start](layout, kind, statics)
    if fast:
        high = [(x, y - float(rng.uniform(0, 5000)), r) for x, y, r in layout.balls]
        layout.balls = []
        for ball in high:
            layout.put(lambda ball=ball: ball)  # type: ignore[misc]  # a default binds the loop's ball
    return _scene(rng, kind, layout, statics, name)


Bar = tuple[tuple[float, float], tuple[float, float]]
Ball = tuple[float, float, float]


class _Layout:
    """Objects placed so far; the static bars come first."""

    def __init__(self, rng: np.random.Generator, overlap: bool) -> None:
        self.rng, self.overlap = rng, overlap
        self.room = FRAME / 3 if overlap else FRAME  # px, side of the square in which objects are drawn
        self.bars: list[Bar] = []
        self.balls: list[Ball] = []

    def put(self, draw: Callable[[], Bar | Ball]) -> None:
        """Add an object drawn until it is free of the others, or else lifted until it is."""
        item = draw()
        for _ in range(_TRIES):
            if self._add(item):
                return
            item = draw()
        while not self._add(item):
            item = _moved(item, 0.0, -_LIFT)

    def put_pair(self, draw: Callable[[], Bar | Ball]) -> None:
        """Add an object and its mirror image."""
        for attempt in range(10 * _TRIES):
            item = _moved(_in_binary(draw()), 0.0, -_LIFT * max(0, attempt - _TRIES))
            if self._add(item):
                if self._add(_mirrored(item)):
                    return
                (self.bars if len(item) == 2 else self.balls).pop()
        raise RuntimeError("a column of hundreds of places has no room for a pair of objects")

    def _add(self, item: Bar | Ball) -> bool:
        items = self.bars if len(item) == 2 else self.balls
        items.append(item)  # type: ignore[arg-type]  # a bar has two points, a ball three numbers
        if self.overlap:
            return True
        layouts = Layouts(np.array(self.bars).reshape(1, -1, 2, 2), np.array(self.balls).reshape(1, -1, 3))
        index = len(self.bars) - 1 if len(item) == 2 else -1
        free = bool((gaps(layouts)[0, index] >= -TOLERANCE).all())
        if not free:
            items.pop()
        return free

    def bar(self) -> Bar:
        """Draw a bar anywhere."""
        low, high = np.log(_LENGTHS)
        half = float(np.exp(self.rng.uniform(low, high))) / 2
        turn = float(self.rng.choice([self.rng.uniform(0, np.pi), 0, np.pi / 2, np.pi / 4]))
        x, y = self.rng.uniform(0, self.room, 2).tolist()
        dx, dy = half * math.cos(turn), half * math.sin(turn)
        return (x - dx, y - dy), (x + dx, y + dy)

    def ball(self) -> Ball:
        """Draw a ball anywhere."""
        x, y = self.rng.uniform(0, self.room, 2).tolist()
        return x, y, float(self.rng.uniform(*_RADII))

    def level(self, x: float, y: float) -> Bar:
        """Draw a level bar with its centre at a place, on whole px."""
        half = float(self.rng.integers(10, 150))
        return (x - half, y), (x + half, y)

    def round(self, x: float, y: float) -> Ball:
        """Draw a ball at a place, of a whole radius."""
        return x, y, float(self.rng.integers(*_RADII))

    def on_something(self, draw: Callable[[float, float], Bar | Ball]) -> Bar | Ball:
        """Draw a level bar or a ball that touches an object from above, or a ball one from its side."""
        items: list[Bar | Ball] = [*self.bars, *self.balls]
        item = draw(float(self.rng.integers(0, 600)), float(self.rng.integers(0, 600)))
        if not items:
            return item
        below = items[int(self.rng.integers(len(items)))]
        (x0, x1), (y0, y1), width = _spans(below)
        height = _half_height(item)
        if len(item) == 3 and self.rng.random() < 0.3:
            return x0 - width - height, float(round((y0 + y1) / 2)), height
        x = float(self.rng.integers(math.floor(x0), math.floor(x1) + 1)) if len(below) == 2 else x0
        return _at(item, x, y0 - width - height)


def _spans(item: Bar | Ball) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return the least and greatest x and y of an object's line, and its radius."""
    if len(item) == 3:
        return (item[0], item[0]), (item[1], item[1]), item[2]
    (ax, ay), (bx, by) = item
    return (min(ax, bx), max(ax, bx)), (min(ay, by), max(ay, by)), BAR_RADIUS


def _half_height(item: Bar | Ball) -> float:
    return item[2] if len(item) == 3 else BAR_RADIUS


def _at(item: Bar | Ball, x: float, y: float) -> Bar | Ball:
    """Move a ball or a level bar so that its centre is at a place."""
    (x0, x1), (y0, _), _ = _spans(item)
    return _moved(item, x - (x0 + x1) / 2, y - y0)


def _moved(item: Bar | Ball, dx: float, dy: float) -> Bar | Ball:
    if len(item) == 3:
        return item[0] + dx, item[1] + dy, item[2]
    (ax, ay), (bx, by) = item
    return (ax + dx, ay + dy), (bx + dx, by + dy)


def _in_binary(item: Bar | Ball) -> Bar | Ball:
    """Round to 1/1024 px, so that the mirror image is exact."""

    def nearest(number: float) -> float:
        return round(number * 1024) / 1024

    if len(item) == 3:
        return nearest(item[0]), nearest(item[1]), nearest(item[2])
    (ax, ay), (bx, by) = item
    return (nearest(ax), nearest(ay)), (nearest(bx), nearest(by))


def _mirrored(item: Bar | Ball) -> Bar | Ball:
    if len(item) == 3:
        return FRAME - item[0], item[1], item[2]
    (ax, ay), (bx, by) = item
    return (FRAME - ax, ay), (FRAME - bx, by)


def _scatter(layout: _Layout, kind: Kind, statics: int) -> None:
    for _ in range(statics + kind.bars):
        layout.put(layout.bar)
    for _ in range(kind.balls):
        layout.put(layout.ball)


def _touch(layout: _Layout, kind: Kind, statics: int) -> None:
    for _ in range(statics):
        x, y = layout.rng.integers(0, 600, 2).tolist()
        layout.put(partial(layout.level, x, y) if layout.rng.random() < 0.7 else layout.bar)
    for _ in range(kind.bars):
        layout.put(partial(layout.on_something, layout.level))
    for _ in range(kind.balls):
        layout.put(partial(layout.on_something, layout.round))


def _stack(layout: _Layout, kind: Kind, statics: int) -> None:
    """Pile the moving bodies, in any order, on the first static bar; the other static bars are scattered."""
    rng = layout.rng
    x, top = float(rng.integers(100, 500)), float(rng.integers(300, 560)) - BAR_RADIUS
    layout.put(partial(layout.level, x, top + BAR_RADIUS))
    pile = [layout.level] * kind.bars + [layout.round] * kind.balls
    moving: list[Bar | Ball] = []
    for k in rng.permutation(kind.moving).tolist():
        item = pile[k](x, 0.0)
        top -= _half_height(item)
        moving.append(_at(item, x, top))
        top -= _half_height(item)
    base = layout.bars[0]
    layout.bars = [base, *(item for item in moving if len(item) == 2)]
    layout.balls = [item for item in moving if len(item) == 3]
    for _ in range(statics - 1):
        layout.put(layout.bar)
        layout.bars.insert(1, layout.bars.pop())


def _mirror(layout: _Layout, kind: Kind, statics: int) -> None:
    """Place mirror images in pairs and what is left of each sort in the middle."""
    sorts: list[tuple[int, Callable[[], Bar | Ball], Callable[[float, float], Bar | Ball]]] = [
        (statics, layout.bar, layout.level),
        (kind.bars, layout.bar, layout.level),
        (kind.balls, layout.ball, layout.round),
    ]
    for count, draw, draw_at in sorts:
        for _ in range(count // 2):
            layout.put_pair(draw)
        if count % 2:
            layout.put(lambda draw_at=draw_at: draw_at(_MIDDLE, float(layout.rng.integers(0, 600))))  # type: ignore[misc]


_ARRANGE: Final[dict[Start, Callable[[_Layout, Kind, int], None]]] = {
    "scattered": _scatter,
    "touching": _touch,
    "stacked": _stack,
    "symmetric": _mirror,
    "overlapping": _scatter,
}


def _scene(rng: np.random.Generator, kind: Kind, layout: _Layout, statics: int, name: str) -> Scene:
    """Shuffle static and moving bars, which keep their order among themselves, and tie the links."""
    bars, balls = len(layout.bars), len(layout.balls)
    moving_places = np.sort(rng.choice(bars, kind.bars, replace=False))
    static_places = np.setdiff1d(np.arange(bars), moving_places)
    blocks = np.empty((bars, 2, 2))
    blocks[static_places], blocks[moving_places] = _points(layout.bars[:statics]), _points(layout.bars[statics:])
    movers = [*moving_places.tolist(), *range(bars, bars + balls)]
    joints, springs = (tuple(_tied(rng, pairs, movers, static_places.tolist())) for pairs in kind.links)
    links = Counter(i for pair in (*joints, *springs) for i in pair)
    free = [i for i in static_places.tolist() if links[i] <= 1]
    chosen = rng.permutation(free)[: int(rng.integers(0, MAX_ELIMINABLE + 1))]
    objects = np.arange(bars + balls)
    return Scene(
        name=name,
        blocks=blocks,
        balls=np.array(layout.balls),
        eliminable=np.isin(objects, chosen),
        dynamic=np.isin(objects, movers),
        joints=joints,
        springs=springs,
    )


def _points(bars: list[Bar]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array(bars, np.float64).reshape(-1, 2, 2)


def _tied(rng: np.random.Generator, pairs: Pairs, movers: list[int], statics: list[int]) -> Iterator[tuple[int, int]]:
    """Give object indices to the links of one sort; no body is tied to one static bar twice."""
    taken: set[tuple[int, int]] = set()
    for a, b in pairs:
        body = movers[b if a == HELD else a]
        other = int(rng.choice([i for i in statics if (body, i) not in taken])) if HELD in (a, b) else -1
        taken.add((body, other))
        yield other if a == HELD else movers[a], other if b == HELD else movers[b]

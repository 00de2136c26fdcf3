"""The elements of the ten basic games, each drawn for n scenes at once. Lengths are in px; y points down.

What holds a ball or a loose bar stands in the upper part of the picture, floors in the lower part.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from iphyre_jax.data.generated.canvas import Bools, Element
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.scenes.geometry import Floats

LEFT, RIGHT, TOP, MIDDLE, LOW = 60.0, 540.0, 60.0, 330.0, 520.0  # where elements begin and end
RADIUS: Final = (14.0, 24.0)  # of a ball

Rng = np.random.Generator


def hold(rng: Rng, n: int) -> Element:
    """A ball above a short bar that can be removed."""
    x, y = _upper(rng, n)
    return Element(_level(x, y, rng.uniform(8, 45, n))[:, None], _always(n), ball=_ball_on(rng, x, y))


def two_holds(rng: Rng, n: int) -> Element:
    """A ball above two bars, one below the other."""
    x, y = _upper(rng, n)
    lower = y + rng.uniform(50, 110, n)
    bars = [_level(x, y, rng.uniform(15, 50, n)), _level(x, lower, rng.uniform(15, 60, n))]
    return Element(np.stack(bars, 1), _always(n, 2), ball=_ball_on(rng, x, y))


def slope(rng: Rng, n: int) -> Element:
    """A ball above a slope, which sometimes cannot be removed."""
    side, (x, y) = _side(rng, n), _upper(rng, n)
    bar = _tilted(x, y, rng.uniform(35, 75, n), side * rng.uniform(0.15, 0.7, n))
    above = np.stack([x - side * rng.uniform(0, 30, n), y - rng.uniform(45, 75, n), _radius(rng, n)], 1)
    return Element(bar[:, None], _often(rng, n, 0.75)[:, None], ball=above)


def wedge(rng: Rng, n: int) -> Element:
    """A ball on a slope behind a bar that keeps it from rolling down."""
    side, (x, y) = _side(rng, n), _upper(rng, n)
    bar = _tilted(x, y, rng.uniform(45, 75, n), side * rng.uniform(0.2, 0.6, n))
    middle = (bar[:, 0] + bar[:, 1]) / 2
    down = np.where((side > 0)[:, None], bar[:, 1], bar[:, 0]) - middle
    radius = _radius(rng, n)
    foot = middle + down * rng.uniform(0.0, 0.3, n)[:, None]
    stop = foot + (down / np.hypot(*down.T)[:, None]) * (radius + BAR_RADIUS + 8)[:, None]
    wall = _upright(stop[:, 0], stop[:, 1] - rng.uniform(48, 60, n), rng.uniform(22, 35, n))
    ball = np.stack([foot[:, 0], foot[:, 1] - radius - BAR_RADIUS - rng.uniform(12, 20, n), radius], 1)
    return Element(np.stack([wall, bar], 1), np.stack([_often(rng, n, 0.9), _often(rng, n, 0.7)], 1), ball=ball)


def vee(rng: Rng, n: int) -> Element:
    """A ball between two slopes that lean towards one another."""
    x, y = _upper(rng, n)
    apart, half = rng.uniform(36, 62, n), rng.uniform(28, 50, n)
    tilt = rng.uniform(0.3, 0.8, n)
    left, right = _tilted(x - apart, y, half, tilt), _tilted(x + apart, y, half, -tilt)
    ball = np.stack([x + rng.uniform(-6, 6, n), y - rng.uniform(0, 30, n), rng.uniform(16, 24, n)], 1)
    return Element(np.stack([left, right], 1), _always(n, 2), ball=ball)


def tied(rng: Rng, n: int, link: int) -> Element:
    """A ball that is tied to a bar and rests on another one: a pendulum or a spring."""
    side, (x, y) = _side(rng, n), _upper(rng, n)
    far, angle = rng.uniform(70, 200, n), rng.uniform(-0.35, 0.6, n)
    ball = np.stack([x + side * far * np.cos(angle), y + far * np.sin(angle), _radius(rng, n)], 1)
    under = ball[:, 1] + ball[:, 2] + BAR_RADIUS + rng.uniform(0.5, 6, n)
    anchor = _level(x, y, rng.uniform(15, 40, n))
    rest = _level(ball[:, 0] + rng.uniform(-8, 8, n), under, rng.uniform(8, 60, n))
    flags = np.stack([_often(rng, n, 0.9), _often(rng, n, 0.95)], 1)
    return Element(np.stack([anchor, rest], 1), flags, ball=ball, link=link)


def loose_on_hold(rng: Rng, n: int) -> Element:
    """A bar that moves, above a bar that can be removed: a hammer or a plug."""
    x, y = _upper(rng, n)
    lying = _tilted(x + rng.uniform(-6, 6, n), y - 2 * BAR_RADIUS - rng.uniform(0.5, 8, n), rng.uniform(8, 55, n), 0.0)
    return Element(np.stack([lying, _level(x, y, rng.uniform(15, 45, n))], 1), _flags(n, False, True), (True, False))


def loose_on_pegs(rng: Rng, n: int) -> Element:
    """A bar that moves, above two pegs at unequal heights: a seesaw or a table."""
    x, y = rng.uniform(LEFT + 60, RIGHT - 60, n), rng.uniform(180, MIDDLE + 20, n)
    half, tilt = rng.uniform(60, 120, n), rng.uniform(-0.3, 0.3, n) * (rng.random(n) < 0.6)
    bar = _tilted(x, y, half, tilt)
    pegs = []
    for end in (-1, 1):
        along = end * rng.uniform(0.45, 0.85, n) * half
        below = 2 * BAR_RADIUS / np.cos(tilt) + rng.uniform(1, 8, n)
        pegs.append(_level(x + along * np.cos(tilt), y + along * np.sin(tilt) + below, rng.uniform(4, 9, n)))
    return Element(np.stack([bar, *pegs], 1), _flags(n, False, True, True), (True, False, False))


def table(rng: Rng, n: int) -> Element:
    """A ball above a bar that moves, which lies on a peg near each end, one above another peg."""
    x, y, half = rng.uniform(LEFT + 90, RIGHT - 90, n), rng.uniform(180, 300, n), rng.uniform(60, 120, n)
    pegs = []
    for side, below in ((-1, 1), (1, 1), (_side(rng, n), 2)):
        at, under = side * (half - rng.uniform(0, 12, n)), y + below * 2 * BAR_RADIUS
        pegs.append(_level(x + at, under + below * rng.uniform(0.5, 9 if below == 1 else 25, n), rng.uniform(4, 8, n)))
    pegs[2] += np.array([0.0, 20.0])
    ball = _ball_on(rng, x + rng.uniform(-0.5, 0.5, n) * half, y)
    bar = _level(x, y, half)
    return Element(np.stack([bar, *pegs], 1), _flags(n, False, True, True, True), (True, False, False, False), ball)


def resting_ball(rng: Rng, n: int) -> Element:
    """A ball without a bar of its own: it falls on what is below it."""
    x, y = _upper(rng, n)
    return Element(np.zeros((n, 0, 2, 2)), np.zeros((n, 0), bool), ball=np.stack([x, y, _radius(rng, n)], 1))


def floor_with_stops(rng: Rng, n: int) -> Element:
    """A floor with two bars on it that can be removed, near one end or at both."""
    x, y, half = rng.uniform(200, 400, n), rng.uniform(380, LOW, n), rng.uniform(90, 180, n)
    side = _side(rng, n)
    first, apart = side * (half - rng.uniform(0, 15, n)), rng.uniform(35, 70, n)
    second = np.where(rng.random(n) < 0.5, first - side * apart, -side * (half - rng.uniform(0, 15, n)))
    posts = [_standing(rng, x + at, y, rng.uniform(15, 42, n)) for at in (first, second)]
    flags = np.stack([_often(rng, n, 0.0), _often(rng, n, 0.95), _often(rng, n, 0.85)], 1)
    return Element(np.stack([_level(x, y, half), *posts], 1), flags)


def floor_with_hole(rng: Rng, n: int) -> Element:
    """Two floors with a hole between them, and a bar that stands on one."""
    y, middle, width = rng.uniform(380, LOW, n), rng.uniform(200, 400, n), rng.uniform(25, 75, n)
    left, right = middle - width - rng.uniform(80, 170, n), middle + width + rng.uniform(80, 170, n)
    floors = [_bar(left, y, middle - width, y), _bar(middle + width, y, right, y + rng.uniform(-25, 25, n))]
    at = np.where(rng.random(n) < 0.5, left + rng.uniform(0, 60, n), middle - width - rng.uniform(0, 25, n))
    post = _standing(rng, at, y, rng.uniform(15, 42, n))
    return Element(np.stack([*floors, post], 1), np.stack([_often(rng, n, 0), _often(rng, n, 0), _often(rng, n)], 1))


def walled_floor(rng: Rng, n: int) -> Element:
    """A floor with a wall at one end that stays."""
    x, y, half = rng.uniform(150, 450, n), rng.uniform(380, LOW, n), rng.uniform(60, 170, n)
    wall = _standing(rng, x + _side(rng, n) * (half - rng.uniform(0, 10, n)), y, rng.uniform(8, 90, n))
    return Element(np.stack([_level(x, y, half), wall], 1), _flags(n, False, False))


def low_slope(rng: Rng, n: int) -> Element:
    """A long slope in the lower part of the picture."""
    x, y = rng.uniform(130, 470, n), rng.uniform(MIDDLE, LOW - 40, n)
    bar = _tilted(x, y, rng.uniform(50, 130, n), _side(rng, n) * rng.uniform(0.1, 0.6, n))
    return Element(bar[:, None], _often(rng, n, 0.3)[:, None])


def shelf(rng: Rng, n: int) -> Element:
    """A level bar in the lower part of the picture."""
    x, y = rng.uniform(LEFT, RIGHT, n), rng.uniform(300, LOW + 20, n)
    return Element(_level(x, y, rng.uniform(20, 90, n))[:, None], _often(rng, n, 0.4)[:, None])


def distractor(rng: Rng, n: int) -> Element:
    """A bar anywhere, of any slope."""
    x, y = rng.uniform(LEFT, RIGHT, n), rng.uniform(TOP, LOW + 30, n)
    tilt = np.where(rng.random(n) < 0.6, 0.0, rng.uniform(-np.pi / 2, np.pi / 2, n))
    return Element(_tilted(x, y, rng.uniform(5, 45, n), tilt)[:, None], _often(rng, n, 0.8)[:, None])


def _upper(rng: Rng, n: int) -> tuple[Floats, Floats]:
    """Return places in the upper part of the picture."""
    return rng.uniform(LEFT, RIGHT, n), rng.uniform(TOP + 40, MIDDLE, n)


def _radius(rng: Rng, n: int) -> Floats:
    """Return radii of balls; that of all basic games is 20 px, and half of them have it."""
    return np.where(rng.random(n) < 0.5, 20.0, rng.uniform(*RADIUS, n))


def _ball_on(rng: Rng, x: Floats, y: Floats) -> Floats:
    """Return balls a little above level bars."""
    radius = _radius(rng, len(x))
    return np.stack([x + rng.uniform(-5, 5, len(x)), y - BAR_RADIUS - radius - rng.uniform(0.5, 30, len(x)), radius], 1)


def _bar(x1: Floats, y1: Floats, x2: Floats, y2: Floats) -> Floats:
    return np.stack([np.stack([x1, y1], -1), np.stack([x2, y2], -1)], 1)


def _level(x: Floats, y: Floats, half: Floats) -> Floats:
    return _bar(x - half, y, x + half, y)


def _upright(x: Floats, y: Floats, half: Floats) -> Floats:
    return _bar(x, y - half, x, y + half)


def _standing(rng: Rng, x: Floats, y: Floats, half: Floats) -> Floats:
    """Return bars that stand on a floor at y, or end a little above it."""
    return _upright(x, y - half - 2 * BAR_RADIUS - rng.uniform(0, 3, len(x)), half)


def _tilted(x: Floats, y: Floats, half: Floats, tilt: Floats | float) -> Floats:
    across, down = half * np.cos(tilt), half * np.sin(tilt)
    return _bar(x - across, y - down, x + across, y + down)


def _side(rng: Rng, n: int) -> Floats:
    return np.where(rng.random(n) < 0.5, -1.0, 1.0)


def _often(rng: Rng, n: int, chance: float = 0.9) -> Bools:
    return np.asarray(rng.random(n) < chance)


def _flags(n: int, *flags: bool) -> Bools:
    return np.tile(np.array(flags, bool), (n, 1))


def _always(n: int, bars: int = 1) -> Bools:
    return np.ones((n, bars), bool)

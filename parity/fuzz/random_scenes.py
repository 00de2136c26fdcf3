"""Random valid scenes that nobody tuned anything for, over a bounded number of layouts to compile.

A template says what moves and what ties it; with at most `STATIC_ROOM` static bars every scene of a template has the
same `Topology`, so all scenes together need as many programs as there are templates. Where things stand is drawn for
trouble: exactly touching, exactly symmetric, stacked, overlapping, or so far up that they tunnel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from iphyre_jax.scenes.compile import STATIC_ROOM
from iphyre_jax.scenes.limits import MAX_ELIMINABLE, MAX_OBJECTS
from iphyre_jax.scenes.scene import Scene

FRAME: Final = 600.0  # px, side of the picture
RADIUS: Final = 10.0  # px, of every bar
STATIC: Final = -1  # the end of a link that a static bar holds
SEED: Final = 0

Point = tuple[float, float]
Ends = tuple[int, int]


@dataclass(frozen=True)
class Template:
    """What moves in a scene and what ties it.

    Attributes:
        bars: moving bars.
        balls: balls.
        joints: moving bodies (bars first) or STATIC at each end of each pin joint.
        springs: the same of the springs.
    """

    bars: int
    balls: int
    joints: tuple[Ends, ...] = ()
    springs: tuple[Ends, ...] = ()

    @property
    def moving(self) -> int:
        """Moving bodies."""
        return self.bars + self.balls

    @property
    def held(self) -> int:
        """Links that need a static bar."""
        return sum(STATIC in ends for ends in (*self.joints, *self.springs))


TEMPLATES: Final = (
    *(Template(*counts) for counts in ((0, 1), (0, 2), (0, 3), (0, 6), (1, 1), (1, 2), (2, 1), (2, 2))),
    *(Template(*counts) for counts in ((3, 1), (3, 3), (5, 1), (1, 5))),
    Template(0, 1, joints=((STATIC, 0),)),
    Template(0, 1, springs=((0, STATIC),)),
    Template(0, 2, joints=((0, 1),)),
    Template(0, 2, springs=((0, 1),)),
    Template(1, 1, joints=((STATIC, 0),)),
    Template(1, 1, joints=((0, 1),)),
    Template(1, 1, springs=((1, 0),)),
    Template(2, 1, joints=((0, 1),), springs=((1, 2),)),
    Template(2, 1, springs=((0, 1), (STATIC, 0))),
    Template(0, 3, joints=((STATIC, 0), (0, 1), (1, 2))),
    Template(1, 2, joints=((STATIC, 0), (1, STATIC)), springs=((STATIC, 2), (1, 2))),
    Template(0, 4, joints=((0, 1), (2, 3)), springs=((1, 2),)),
)


@dataclass(frozen=True)
class Body:
    """A bar or a ball somewhere: a line between two points, of length zero for a ball, and a radius."""

    a: Point
    b: Point
    radius: float = RADIUS

    @property
    def middle(self) -> Point:
        """Centre of the body."""
        return (self.a[0] + self.b[0]) / 2, (self.a[1] + self.b[1]) / 2

    def moved(self, x: float, y: float) -> Body:
        """The same body elsewhere."""
        return Body((self.a[0] + x, self.a[1] + y), (self.b[0] + x, self.b[1] + y), self.radius)

    def mirrored(self) -> Body:
        """The same body on the other side of the picture's middle."""
        return Body((FRAME - self.a[0], self.a[1]), (FRAME - self.b[0], self.b[1]), self.radius)


@dataclass
class _Sketch:
    """A scene while it is drawn: a grid of `step` px (0 for none) makes touching and symmetry exact."""

    rng: np.random.Generator
    step: float
    bodies: list[Body] = field(default_factory=list)

    def snapped(self, value: float) -> float:
        return round(value / self.step) * self.step if self.step else value

    def uniform(self, low: float, high: float) -> float:
        return self.snapped(float(self.rng.uniform(low, high)))

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def other(self) -> Body | None:
        return self.bodies[int(self.rng.integers(len(self.bodies)))] if self.bodies else None


def random_scene(index: int, seed: int = SEED) -> Scene:
    """Draw one scene.

    Args:
        index: of the scene, at least 0; the template is `TEMPLATES[index % len(TEMPLATES)]`.
        seed: of the whole set, at least 0.

    Returns:
        A valid scene of 1 to 12 objects, named after seed and index. An eliminable bar carries at most one joint or
        spring: with two the reference's order of removal is undefined.

    Raises:
        ValueError: if `index` or `seed` is negative.
    """
    if index < 0 or seed < 0:
        raise ValueError(f"index, seed: expected integers of at least 0, got {index!r}, {seed!r}")
    rng = np.random.default_rng([seed, index])
    template = TEMPLATES[index % len(TEMPLATES)]
    while True:
        try:
            return _draw(rng, template, f"random-{seed}-{index}")
        except ValueError:  # a pin between equal centres, say: drawn again
            continue


def _draw(rng: np.random.Generator, template: Template, name: str) -> Scene:
    sketch = _Sketch(rng, float(rng.choice([0.0, 1.0, 10.0])))
    room = min(STATIC_ROOM, MAX_OBJECTS - template.moving)
    count = int(rng.integers(min(1, template.held), room + 1))
    for _ in range(count):
        sketch.bodies.append(_placed(sketch, _bar(sketch), _STATIC_PLACES))
    for k in range(template.moving):
        body = _bar(sketch) if k < template.bars else _ball(sketch)
        sketch.bodies.append(_placed(sketch, body, _MOVING_PLACES))
    statics, bars, balls = np.split(np.array(sketch.bodies, object), [count, count + template.bars])

    order = rng.permutation(count + template.bars)  # blocks are static and moving bars in any order
    blocks = [(*statics, *bars)[k] for k in order]
    dynamic = order >= count
    # Moving bodies are counted in list order, so that the scene has the template's topology.
    movers = [*np.flatnonzero(dynamic).tolist(), *range(len(blocks), len(blocks) + len(balls))]
    resting = np.flatnonzero(~dynamic).tolist()
    eliminable = rng.permutation(resting)[: int(rng.integers(0, MAX_ELIMINABLE + 1))].tolist()
    ends = _links(rng, template, movers, resting, eliminable)
    joints = len(template.joints)
    total = len(blocks) + len(balls)
    return Scene(
        name=name,
        blocks=[[body.a, body.b] for body in blocks],  # type: ignore[arg-type]  # lists become arrays
        balls=[(*body.a, body.radius) for body in balls],  # type: ignore[arg-type]
        eliminable=np.isin(np.arange(total), eliminable),
        dynamic=np.isin(np.arange(total), movers),
        joints=tuple(ends[:joints]),
        springs=tuple(ends[joints:]),
    )


def _links(
    rng: np.random.Generator, template: Template, movers: list[int], resting: list[int], eliminable: list[int]
) -> list[Ends]:
    """Give every static end a bar; an eliminable one is taken once only."""
    free = list(resting)
    links = []
    for ends in (*template.joints, *template.springs):
        if STATIC in ends and not free:
            raise ValueError("too few static bars for the links")
        held = int(rng.choice(free)) if STATIC in ends else STATIC
        if held in eliminable:
            free.remove(held)
        one, two = (held if end == STATIC else movers[end] for end in ends)
        links.append((one, two))
    return links


def _bar(sketch: _Sketch) -> Body:
    """A bar around the origin: level, upright or at any angle, 1 to 400 px long."""
    kind = sketch.rng.random()
    angle = 0.0 if kind < 0.5 else math.pi / 2 if kind < 0.6 else float(sketch.rng.uniform(0, math.pi))
    long = 2 * max(sketch.snapped(float(np.exp(sketch.rng.uniform(0, math.log(400.0)))) / 2), 0.5)
    if kind < 0.6:
        x, y = (long / 2, 0.0) if kind < 0.5 else (0.0, long / 2)
    else:
        x, y = (sketch.snapped(long / 2 * turned) for turned in (math.cos(angle), math.sin(angle)))
    if x == y == 0.0:
        x = 0.5
    return Body((-x, -y), (x, y)) if sketch.chance(0.5) else Body((x, y), (-x, -y))


def _ball(sketch: _Sketch) -> Body:
    common = float(sketch.rng.choice([5.0, 10.0, 20.0, 20.0, 30.0, 60.0]))
    radius = common if sketch.chance(0.7) else float(sketch.rng.uniform(3.0, 60.0))
    return Body((0.0, 0.0), (0.0, 0.0), radius)


def _placed(sketch: _Sketch, body: Body, places: tuple[tuple[float, Callable[..., Body]], ...]) -> Body:
    """Put a body at one of the places, each chosen with its weight."""
    weights = np.array([weight for weight, _ in places])
    place = places[int(sketch.rng.choice(len(places), p=weights / weights.sum()))][1]
    other = sketch.other()
    return _anywhere(sketch, body) if other is None else place(sketch, body, other)


def _anywhere(sketch: _Sketch, body: Body, _: Body | None = None) -> Body:
    return body.moved(sketch.uniform(0, FRAME), sketch.uniform(0, FRAME))


def _far_up(sketch: _Sketch, body: Body, _: Body) -> Body:
    """So high that it falls through bars: from 6000 px it arrives with 1100 px/s."""
    return body.moved(sketch.uniform(0, FRAME), sketch.uniform(-6000, -300))


def _overlapping(sketch: _Sketch, body: Body, other: Body) -> Body:
    x, y = other.middle
    return body.moved(x + sketch.uniform(-30, 30), y + sketch.uniform(-30, 30))


def _mirrored(sketch: _Sketch, body: Body, other: Body) -> Body:
    """As the other one's image, if it is of the same kind; else in the exact middle of the picture."""
    if (other.a == other.b) == (body.a == body.b):
        return other.mirrored()
    return body.moved(FRAME / 2, other.middle[1] - sketch.uniform(0, 200))


def _beside(sketch: _Sketch, body: Body, other: Body) -> Body:
    """Level with the other one, end to end, with a gap of exactly zero."""
    reach = max(other.a[0], other.b[0]) + other.radius + body.radius
    return body.moved(reach - min(body.a[0], body.b[0]), other.middle[1])


def _on_top(sketch: _Sketch, body: Body, other: Body) -> Body:
    """On the other one with a gap of zero, exactly so for level bars and balls: in its middle, or anywhere along it."""
    way = (other.b[0] - other.a[0], other.b[1] - other.a[1])
    size = math.hypot(*way)
    if body.a != body.b and size and sketch.chance(0.5):  # a bar on a bar: parallel to it
        half = math.hypot(body.b[0] - body.a[0], body.b[1] - body.a[1]) / 2
        x, y = way[0] / size * half, way[1] / size * half
        body = Body((-x, -y), (x, y))
    up = (way[1] / size, -way[0] / size) if size else sketch.rng.choice([(0.0, -1.0), (0.6, -0.8), (-0.6, -0.8)])
    if up[1] > 0:
        up = (-up[0], -up[1])
    along = 0.5 if sketch.chance(0.5) else float(sketch.rng.choice([0.0, 0.25, 0.75, 1.0, sketch.rng.random()]))
    x, y = other.a[0] + along * way[0], other.a[1] + along * way[1]
    reach = other.radius + body.radius
    return body.moved(x + float(up[0]) * reach, y + float(up[1]) * reach)


_STATIC_PLACES: Final = ((0.6, _anywhere), (0.15, _beside), (0.15, _mirrored), (0.1, _on_top))
_MOVING_PLACES: Final = (
    (0.25, _anywhere),
    (0.35, _on_top),
    (0.1, _beside),
    (0.1, _mirrored),
    (0.1, _overlapping),
    (0.1, _far_up),
)

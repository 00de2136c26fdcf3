"""Random valid scenes over a bounded number of layouts to compile.

A template says which bodies move and which joints and springs hold them. All scenes of a template have the same
`Topology`, since none has more than `STATIC_ROOM` static bars: there is one program to compile for each template.
Positions are drawn to cause trouble: exactly touching, exactly symmetric, stacked, overlapping, or so far up that the
body tunnels through others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from iphyre_jax.checks import check_whole
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes.compile import STATIC_ROOM
from iphyre_jax.scenes.limits import MAX_ELIMINABLE, MAX_OBJECTS
from iphyre_jax.scenes.scene import Scene

RADIUS: Final = 10.0  # px, of every bar
STATIC: Final = -1  # an end of a joint or spring that a static bar holds
SEED: Final = 0

Point = tuple[float, float]
Ends = tuple[int, int]


@dataclass(frozen=True)
class Template:
    """The moving bodies of a scene, its joints and its springs.

    Attributes:
        bars: moving bars.
        balls: balls.
        joints: the ends of each pin joint: a moving body (bars first) or STATIC.
        springs: the ends of each spring.
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
        """Joints and springs that need a static bar."""
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
    """A bar or a ball: the end points of its axis, equal for a ball, and its radius."""

    a: Point
    b: Point
    radius: float = RADIUS

    @property
    def middle(self) -> Point:
        """Centre of the body."""
        return (self.a[0] + self.b[0]) / 2, (self.a[1] + self.b[1]) / 2

    def moved(self, x: float, y: float) -> Body:
        """The body moved by (x, y) px."""
        return Body((self.a[0] + x, self.a[1] + y), (self.b[0] + x, self.b[1] + y), self.radius)

    def mirrored(self) -> Body:
        """The body mirrored left to right in the middle of the picture."""
        return Body((SCREEN - self.a[0], self.a[1]), (SCREEN - self.b[0], self.b[1]), self.radius)


@dataclass
class _Draft:
    """An unfinished scene; a grid of `step` px (0 for none) makes touching and symmetry exact."""

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
        A valid scene of 1 to 12 objects, named after seed and index. An eliminable bar holds at most one joint or
        spring: with two, the reference removes them in an undefined order.

    Raises:
        ValueError: `index` or `seed` is no whole number of at least 0; one line.
    """
    for name, number in (("index", index), ("seed", seed)):
        check_whole(name, number, 0)
    rng = np.random.default_rng([seed, index])
    template = TEMPLATES[index % len(TEMPLATES)]
    while True:
        try:
            return _draw(rng, template, f"random-{seed}-{index}")
        except ValueError:  # not valid, such as a joint between equal centres: draw again
            continue


def _draw(rng: np.random.Generator, template: Template, name: str) -> Scene:
    draft = _Draft(rng, float(rng.choice([0.0, 1.0, 10.0])))
    room = min(STATIC_ROOM, MAX_OBJECTS - template.moving)
    count = int(rng.integers(min(1, template.held), room + 1))
    for _ in range(count):
        draft.bodies.append(_placed(draft, _bar(draft), _STATIC_PLACES))
    for k in range(template.moving):
        body = _bar(draft) if k < template.bars else _ball(draft)
        draft.bodies.append(_placed(draft, body, _MOVING_PLACES))
    statics, bars, balls = np.split(np.array(draft.bodies, object), [count, count + template.bars])

    order = rng.permutation(count + template.bars)  # blocks are static and moving bars in any order
    blocks = [(*statics, *bars)[k] for k in order]
    dynamic = order >= count
    # Joints and springs count the moving bodies in list order, so that the scene has the template's topology.
    movers = [*np.flatnonzero(dynamic).tolist(), *range(len(blocks), len(blocks) + len(balls))]
    resting = np.flatnonzero(~dynamic).tolist()
    eliminable = rng.permutation(resting)[: int(rng.integers(0, MAX_ELIMINABLE + 1))].tolist()
    ends = _constraints(rng, template, movers, resting, eliminable)
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


def _constraints(
    rng: np.random.Generator, template: Template, movers: list[int], resting: list[int], eliminable: list[int]
) -> list[Ends]:
    """Choose a bar for every static end, an eliminable bar at most once."""
    free = list(resting)
    constraints = []
    for ends in (*template.joints, *template.springs):
        if STATIC in ends and not free:
            raise ValueError("too few static bars for the joints and springs")
        held = int(rng.choice(free)) if STATIC in ends else STATIC
        if held in eliminable:
            free.remove(held)
        one, two = (held if end == STATIC else movers[end] for end in ends)
        constraints.append((one, two))
    return constraints


def _bar(draft: _Draft) -> Body:
    """A bar centred on the origin, level, upright or at any angle, 1 to 400 px long."""
    draw = draft.rng.random()
    angle = 0.0 if draw < 0.5 else math.pi / 2 if draw < 0.6 else float(draft.rng.uniform(0, math.pi))
    length = 2 * max(draft.snapped(float(np.exp(draft.rng.uniform(0, math.log(400.0)))) / 2), 0.5)
    if draw < 0.6:
        x, y = (length / 2, 0.0) if draw < 0.5 else (0.0, length / 2)
    else:
        x, y = (draft.snapped(length / 2 * turned) for turned in (math.cos(angle), math.sin(angle)))
    if x == y == 0.0:
        x = 0.5
    return Body((-x, -y), (x, y)) if draft.chance(0.5) else Body((x, y), (-x, -y))


def _ball(draft: _Draft) -> Body:
    common = float(draft.rng.choice([5.0, 10.0, 20.0, 20.0, 30.0, 60.0]))
    radius = common if draft.chance(0.7) else float(draft.rng.uniform(3.0, 60.0))
    return Body((0.0, 0.0), (0.0, 0.0), radius)


def _placed(draft: _Draft, body: Body, places: tuple[tuple[float, Callable[..., Body]], ...]) -> Body:
    """Put a body at one of the places, drawn by their weights."""
    weights = np.array([weight for weight, _ in places])
    place = places[int(draft.rng.choice(len(places), p=weights / weights.sum()))][1]
    other = draft.other()
    return _anywhere(draft, body) if other is None else place(draft, body, other)


def _anywhere(draft: _Draft, body: Body, _: Body | None = None) -> Body:
    return body.moved(draft.uniform(0, SCREEN), draft.uniform(0, SCREEN))


def _far_up(draft: _Draft, body: Body, _: Body) -> Body:
    """So high that it falls through bars: from 6000 px up it arrives at 1100 px/s."""
    return body.moved(draft.uniform(0, SCREEN), draft.uniform(-6000, -300))


def _overlapping(draft: _Draft, body: Body, other: Body) -> Body:
    x, y = other.middle
    return body.moved(x + draft.uniform(-30, 30), y + draft.uniform(-30, 30))


def _mirrored(draft: _Draft, body: Body, other: Body) -> Body:
    """The mirror image of another of the same kind; else in the exact middle of the picture."""
    if (other.a == other.b) == (body.a == body.b):
        return other.mirrored()
    return body.moved(SCREEN / 2, other.middle[1] - draft.uniform(0, 200))


def _beside(draft: _Draft, body: Body, other: Body) -> Body:
    """Beside another body at the same height, end to end, with a gap of exactly zero."""
    reach = max(other.a[0], other.b[0]) + other.radius + body.radius
    return body.moved(reach - min(body.a[0], body.b[0]), other.middle[1])


def _on_top(draft: _Draft, body: Body, other: Body) -> Body:
    """On another body, in its middle or anywhere along it; the gap of zero is exact for level bars and balls."""
    axis = (other.b[0] - other.a[0], other.b[1] - other.a[1])
    size = math.hypot(*axis)
    if body.a != body.b and size and draft.chance(0.5):  # a bar on a bar: parallel to it
        half = math.hypot(body.b[0] - body.a[0], body.b[1] - body.a[1]) / 2
        x, y = axis[0] / size * half, axis[1] / size * half
        body = Body((-x, -y), (x, y))
    normal = (axis[1] / size, -axis[0] / size) if size else draft.rng.choice([(0.0, -1.0), (0.6, -0.8), (-0.6, -0.8)])
    if normal[1] > 0:
        normal = (-normal[0], -normal[1])
    along = 0.5 if draft.chance(0.5) else float(draft.rng.choice([0.0, 0.25, 0.75, 1.0, draft.rng.random()]))
    x, y = other.a[0] + along * axis[0], other.a[1] + along * axis[1]
    reach = other.radius + body.radius
    return body.moved(x + float(normal[0]) * reach, y + float(normal[1]) * reach)


_STATIC_PLACES: Final = ((0.6, _anywhere), (0.15, _beside), (0.15, _mirrored), (0.1, _on_top))
_MOVING_PLACES: Final = (
    (0.25, _anywhere),
    (0.35, _on_top),
    (0.1, _beside),
    (0.1, _mirrored),
    (0.1, _overlapping),
    (0.1, _far_up),
)

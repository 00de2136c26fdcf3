"""Nearest side of two bars' difference set, searched for as the reference does it (float64).

The difference set {q - p}, with p on the first bar's core line and q on the second's, is a parallelogram. Its side
nearest to the origin gives the contact normal. If the core lines do not cross, the search of Gilbert, Johnson and
Keerthi (GJK) finds it; if they cross, the expanding polytope algorithm (EPA) does. Two sides may be equally near
(parallel bars), and their distances round differently. So the path of the search decides the last digits, and the
search starts from the side at which the last step's search ended.

Exchanging the bars turns the set by half a circle, so the result does not depend on the bars' roles.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.physics.types import Segment
from iphyre_jax.physics.vector import Vec, dot, length, normalized, perp, product, where

MAX_ITERATIONS = 30  # of the reference's search
NO_SIDE = 0  # corner 0 twice


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Corner:
    """A corner of the difference set."""

    at: Vec  # px
    code: jax.Array  # int32, 2 * end of the first bar + end of the second


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Search:
    v: Corner  # the side v-w is the nearest so far, the origin to its left
    w: Corner
    farthest: Corner  # across that side, towards the origin
    searching: jax.Array  # bool
    encloses: jax.Array  # bool, the origin lies in the triangle of the three
    iteration: jax.Array  # () int32


def separation(one: Segment, two: Segment, start: jax.Array) -> tuple[Vec, jax.Array, jax.Array]:
    """Return how far two core lines are apart, and in which direction.

    Args:
        one: first bar.
        two: second bar.
        start: int32, the side to start from, 4 * corner + corner; NO_SIDE to choose one by the bars' boxes.

    Returns:
        The unit normal, from the first to the second bar (the zero vector for two bars on exactly one line); the
        distance, px, negative if the core lines cross; the side found, int32.
    """
    v, w = _start(one, two, start)
    on = jnp.ones_like(start, bool)
    first = _Search(v, w, v, on, ~on, jnp.int32(0))
    found = jax.lax.while_loop(
        lambda s: jnp.any(s.searching) & (s.iteration < MAX_ITERATIONS), lambda s: _exchange(one, two, s), first
    )
    v, w = jax.lax.cond(jnp.any(found.encloses), lambda s: _expand(one, two, s), lambda s: (s.v, s.w), found)
    point, inner, edge = nearest(v.at, w.at)
    unit, far = normalized(-perp(edge)), length(point)
    signed = dot(unit, point)
    inner = inner | (signed <= 0)
    normal = where(inner, unit, point * (1.0 / (far + jnp.finfo(far.dtype).tiny)))
    return normal, jnp.where(inner, signed, far), 4 * v.code + w.code


def nearest(a: Vec, b: Vec) -> tuple[Vec, jax.Array, Vec]:
    """Return the point of the side a-b nearest to the origin, whether it lies between the ends, and b - a."""
    edge = b - a
    t = -jnp.clip(dot(edge, a + b) / (dot(edge, edge) + jnp.finfo(a.x.dtype).tiny), -1, 1)
    half = 0.5 * t
    return a * (0.5 - half) + b * (0.5 + half), (t > -1) & (t < 1), edge


def _start(one: Segment, two: Segment, side: jax.Array) -> tuple[Corner, Corner]:
    """Return the corners of a side; for NO_SIDE the two farthest corners across the line of the boxes' centres."""
    across = perp(_box_centre(one) - _box_centre(two))
    known = side != NO_SIDE
    v = _choose(known, _corner(one, two, side >> 2), _support(one, two, across))
    return v, _choose(known, _corner(one, two, side & 3), _support(one, two, -across))


def _exchange(one: Segment, two: Segment, search: _Search) -> _Search:
    """Find the corner farthest towards the origin; if it is nearer than the side, it replaces one of its ends."""
    behind = _greater(search.w.at, search.v.at)
    v, w = _choose(behind, search.w, search.v), _choose(behind, search.v, search.w)
    point, inner, edge = nearest(v.at, w.at)
    towards = where(inner, perp(edge), -point)
    p = _support(one, two, towards)
    encloses = _greater(p.at, v.at) & _greater(w.at, p.at)
    nearer = dot(p.at, towards) > jnp.maximum(dot(v.at, towards), dot(w.at, towards))
    searching = search.searching & ~encloses & nearer
    keeps_v = _distance(v, p) < _distance(p, w)
    return _Search(
        _choose(searching & ~keeps_v, p, v),
        _choose(searching & keeps_v, p, w),
        p,
        searching,
        encloses,
        search.iteration + 1,
    )


def _expand(one: Segment, two: Segment, search: _Search) -> tuple[Corner, Corner]:
    """Return the nearest side where the origin lies inside; of equally near ones, the reference's first."""
    a, b, c = _nearest_side([search.w, search.v, search.farthest])
    q = _support(one, two, perp(b.at - a.at))
    beyond = (q.code != a.code) & (q.code != b.code) & _greater(a.at, b.at, q.at)
    far_a, far_b, *_ = _nearest_side([a, q, b, c])
    inside = search.encloses
    return (_choose(inside, _choose(beyond, far_a, a), search.v), _choose(inside, _choose(beyond, far_b, b), search.w))


def _nearest_side(hull: list[Corner]) -> list[Corner]:
    """Return the corners of a hull from the one at which the side nearest to the origin begins; the first of equals."""
    turns = [hull[k:] + hull[:k] for k in range(len(hull))]
    best, square = turns[0], _distance(*hull[:2])
    for turn in turns[1:]:
        other = _distance(*turn[:2])
        nearer = other < square
        square = jnp.minimum(square, other)
        best = [_choose(nearer, new, old) for new, old in zip(turn, best, strict=True)]
    return best


def _distance(a: Corner, b: Corner) -> jax.Array:
    """Return the square of a side's distance from the origin."""
    point, *_ = nearest(a.at, b.at)
    return dot(point, point)


def _box_centre(bar: Segment) -> Vec:
    """Return the centre of a bar's box, rounded as the reference's."""

    def middle(p: jax.Array, q: jax.Array) -> jax.Array:
        low, high = jnp.minimum(p, q) - BAR_RADIUS, jnp.maximum(p, q) + BAR_RADIUS
        return product(low, jnp.array(0.5, low.dtype)) + product(high, jnp.array(0.5, low.dtype))

    return Vec(middle(bar.a.x, bar.b.x), middle(bar.a.y, bar.b.y))


def _corner(one: Segment, two: Segment, code: jax.Array) -> Corner:
    return Corner(where(code & 1 != 0, two.b, two.a) - where(code & 2 != 0, one.b, one.a), code)


def _support(one: Segment, two: Segment, direction: Vec) -> Corner:
    """Return the corner that lies farthest in a direction."""
    first_b = ~(dot(one.a, -direction) > dot(one.b, -direction))
    second_b = ~(dot(two.a, direction) > dot(two.b, direction))
    return _corner(one, two, 2 * first_b.astype(jnp.int32) + second_b.astype(jnp.int32))


def _choose(mask: jax.Array, a: Corner, b: Corner) -> Corner:
    return jax.tree.map(lambda x, y: jnp.where(mask, x, y), a, b)


def _greater(a: Vec, b: Vec, c: Vec | None = None) -> jax.Array:
    """Return whether c (default: the origin) lies strictly right of the line from a to b, in the reference's sense."""
    x, y = a.x + b.x, a.y + b.y
    if c is not None:
        x, y = x - 2 * c.x, y - 2 * c.y
    return product(b.y - a.y, x) > product(b.x - a.x, y)

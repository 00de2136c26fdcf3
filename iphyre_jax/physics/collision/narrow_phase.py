"""Contact points of two shapes: one function for each pair of shapes, named as in the reference.

Normals point from the first shape to the second; contact points lie on the surfaces. Strict and non-strict comparisons
matter: circles touch when strictly nearer than the sum of their radii, segments when not farther.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from iphyre_jax.physics import lanes
from iphyre_jax.physics.collision import gjk
from iphyre_jax.physics.collision.gjk import nearest
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.physics.types import Segment
from iphyre_jax.physics.vector import Vec, clamp01, cross, dot, length, lerp, normalized, product, rounded, where


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ManifoldPoint:
    """One possible contact point."""

    touching: jax.Array  # bool
    normal: Vec  # unit, from the first shape to the second
    on_first: Vec  # px, point on the first shape's surface
    on_second: Vec
    id: jax.Array  # int32; bars: 2 * end of the first + end of the second


def circle_circle(
    centre_a: Vec, radius_a: jax.Array, centre_b: Vec, radius_b: jax.Array, first_is_a: jax.Array
) -> ManifoldPoint:
    """Return the contact of two balls. If their centres coincide, the normal is along x, from role a to role b."""
    delta, reach = centre_b - centre_a, radius_a + radius_b
    right = _signed(jnp.ones_like(delta.x), first_is_a)
    return _round_contact(centre_a, radius_a, centre_b, radius_b, delta, reach, Vec(right, jnp.zeros_like(right)))


def circle_segment(centre: Vec, radius: jax.Array, bar: Segment) -> ManifoldPoint:
    """Return the contact of a ball and a bar: the ball against the nearest point of the core line."""
    along = bar.b - bar.a
    t = clamp01(dot(along, centre - bar.a) / dot(along, along))
    closest = bar.a + along * t
    bar_radius = jnp.full_like(radius, BAR_RADIUS)
    return _round_contact(centre, radius, closest, bar_radius, closest - centre, radius + bar_radius, bar.normal)


def _round_contact(
    p: Vec, radius_p: jax.Array, q: Vec, radius_q: jax.Array, delta: Vec, reach: jax.Array, if_coincident: Vec
) -> ManifoldPoint:
    """Return the contact of two discs around p and q, `delta` = q - p."""
    square = dot(delta, delta)
    distance = rounded(jnp.sqrt(square))
    apart = distance != 0
    normal = where(apart, delta * (1.0 / jnp.where(apart, distance, 1)), if_coincident)
    touching = square < product(reach, reach)
    return ManifoldPoint(
        touching, normal, p + normal * radius_p, q + normal * -radius_q, jnp.zeros_like(touching, jnp.int32)
    )


def segment_segment(
    one: Segment, two: Segment, first_is_a: jax.Array, start: jax.Array | None
) -> tuple[tuple[ManifoldPoint, ManifoldPoint], jax.Array | None]:
    """Return the two possible contact points of two bars, in the reference's order for roles (one, two).

    Exchanging the bars flips the normal and exchanges the points.

    Args:
        one: first bar.
        two: second bar.
        first_is_a: bool, whether the first bar has the reference's role a; decides roundings only.
        start: float64: side from which to search, see `gjk.separation`; float32: None.

    Returns:
        The points, and float64: the side found.
    """
    if start is not None:
        normal, distance, side = gjk.separation(one, two, start)
        return _clip(one, two, normal, distance <= 2 * BAR_RADIUS, first_is_a), side
    (normal, distance), (crossing, collinear) = lanes.materialize(lambda: (_separation(one, two), _crossing(one, two)))
    normal, distance = _push_out(one, two, crossing, normal, distance)
    near = (distance <= 2 * BAR_RADIUS) & ~collinear & ((normal.x != 0) | (normal.y != 0))
    return _clip(one, two, normal, near, first_is_a), None


def _separation(one: Segment, two: Segment) -> tuple[Vec, jax.Array]:
    """Return normal and distance of two core lines that do not cross.

    For float32: takes the nearest of the four sides of the difference set. The reference's search decides between
    equally near sides by rounding, and float32 rounds otherwise: with that search, multi_ball_lever at 10 fps fell from
    94 % of plans within 1 px to none.
    """
    sides = _sides(one, two)
    point, inner, edge = nearest(*sides[0])
    best = dot(point, point)
    for side in sides[1:]:
        other_point, other_inner, other_edge = nearest(*side)
        square = dot(other_point, other_point)
        nearer = square < best
        best = jnp.minimum(best, square)
        point, edge = where(nearer, other_point, point), where(nearer, other_edge, edge)
        inner = jnp.where(nearer, other_inner, inner)
    unit = normalized(Vec(edge.y, -edge.x))
    signed = dot(unit, point)
    unit = where(signed < 0, -unit, unit)
    far = length(point)
    tiny = jnp.finfo(far.dtype).tiny
    normal = where(inner, unit, point * (1.0 / (far + tiny)))
    distance = jnp.where(inner, jnp.abs(signed), far)
    return normal, distance


def _sides(one: Segment, two: Segment) -> list[tuple[Vec, Vec]]:
    """Return the four sides of two bars' difference set by their corners."""
    corners = two.a - one.a, two.b - one.a, two.a - one.b, two.b - one.b
    return [(corners[i], corners[j]) for i, j in ((0, 1), (2, 3), (0, 2), (1, 3))]


def _crossing(one: Segment, two: Segment) -> tuple[jax.Array, jax.Array]:
    """Return whether two core lines cross strictly between their ends, and whether they lie on exactly one line."""
    along_one, along_two, offset = one.b - one.a, two.b - two.a, two.a - one.a
    area = cross(along_one, along_two)
    parallel = area == 0
    safe = jnp.where(parallel, 1, area)
    s, t = cross(offset, along_two) / safe, cross(offset, along_one) / safe
    crossing = ~parallel & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    return crossing, parallel & (cross(along_one, offset) == 0)


def _push_out(
    one: Segment, two: Segment, crossing: jax.Array, normal: Vec, distance: jax.Array
) -> tuple[Vec, jax.Array]:
    """Where core lines cross, return the inward normal of the difference set's nearest side and minus its distance."""

    def push(_: None) -> tuple[Vec, jax.Array]:
        best, out = jnp.full_like(distance, jnp.inf), normal
        for a, b in _sides(one, two):
            unit = normalized(Vec(b.y - a.y, a.x - b.x))
            height = dot(unit, a)
            nearer = jnp.abs(height) < best
            best = jnp.where(nearer, jnp.abs(height), best)
            out = where(nearer, where(height > 0, -unit, unit), out)
        return where(crossing, out, normal), jnp.where(crossing, -best, distance)

    return jax.lax.cond(jnp.any(crossing), push, lambda _: (normal, distance), None)


def _signed(value: jax.Array, positive: jax.Array) -> jax.Array:
    return jnp.where(positive, value, -value)


def _clip(
    one: Segment, two: Segment, normal: Vec, near: jax.Array, first_is_a: jax.Array
) -> tuple[ManifoldPoint, ManifoldPoint]:
    """Return the contact points where the bars' facing sides overlap along the contact.

    The reference computes from role a to role b. In exchanged roles all lengths along the contact change sign, except
    the tiny number that prevents 1 / 0. It decides where a bar that lies across the contact is met.
    """
    flip_one, flip_two = ~(dot(one.normal, normal) > 0), ~(dot(two.normal, -normal) > 0)
    one_a, one_b = where(flip_one, one.b, one.a), where(flip_one, one.a, one.b)
    two_a, two_b = where(flip_two, two.b, two.a), where(flip_two, two.a, two.b)
    tiny = _signed(jnp.full_like(normal.x, jnp.finfo(normal.x.dtype).tiny), first_is_a)
    u_one_a, u_one_b, u_two_a, u_two_b = (cross(end, normal) for end in (one_a, one_b, two_a, two_b))
    scale_one = 1.0 / (u_one_b - u_one_a + tiny)
    scale_two = 1.0 / (u_two_b - u_two_a + tiny)
    out = normal * jnp.array(BAR_RADIUS, normal.x.dtype)
    end_one, end_two = flip_one.astype(jnp.int32), flip_two.astype(jnp.int32)

    def point(u_two: jax.Array, u_one: jax.Array, point_id: jax.Array) -> ManifoldPoint:
        on_one = out + lerp(one_a, one_b, clamp01(product(u_two - u_one_a, scale_one)))
        on_two = -out + lerp(two_a, two_b, clamp01(product(u_one - u_two_a, scale_two)))
        touching = near & (dot(on_two - on_one, normal) <= 0)
        return ManifoldPoint(touching, normal, on_one, on_two, point_id)

    first = point(u_two_b, u_one_a, 2 * end_one + (1 - end_two))
    second = point(u_two_a, u_one_b, 2 * (1 - end_one) + end_two)
    return first, second

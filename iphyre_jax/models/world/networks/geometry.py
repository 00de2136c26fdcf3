"""Where two objects are nearest: bars are segments with a radius, balls are segments of no length."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

SAME_POINT = 5.0  # px: two contacts of a pair lie at least so far apart
FAR = 1e4  # px, the gap of a second contact that is not there
TINY = 1e-6  # px^2


class Contact(NamedTuple):
    """The two places where a pair of objects is nearest, as object i sees it; any axes in front."""

    gap: jax.Array  # (...) px between the surfaces, negative if they overlap
    normal: jax.Array  # (..., 2) unit vector from j to i
    tangent: jax.Array  # (..., 2) the normal turned by a right angle
    arm_i: jax.Array  # (..., 2) px, from i's centre to its surface
    arm_j: jax.Array  # (..., 2) px
    second_gap: jax.Array  # (...) px, at another end of i; FAR if there is none
    second_arm: jax.Array  # (..., 2) px, from i's centre to its axis there


def cross(a: jax.Array, b: jax.Array) -> jax.Array:
    """(..., 2), (..., 2) -> (...)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def dot(a: jax.Array, b: jax.Array) -> jax.Array:
    """(..., 2), (..., 2) -> (...)."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def perpendicular(a: jax.Array) -> jax.Array:
    """Vectors (..., 2) turned from x to y by a right angle."""
    return jnp.stack([-a[..., 1], a[..., 0]], axis=-1)


def rotated(a: jax.Array, angle: jax.Array) -> jax.Array:
    """Vectors (..., 2) turned from x to y by (...) rad."""
    return a * jnp.cos(angle)[..., None] + perpendicular(a) * jnp.sin(angle)[..., None]


def length(a: jax.Array) -> jax.Array:
    """(..., 2) -> (...), with a gradient at zero."""
    return jnp.sqrt(dot(a, a) + TINY)


def nearest_on(point: jax.Array, centre: jax.Array, half: jax.Array) -> jax.Array:
    """The point of a segment, centre ± half, that is nearest to another point; all (..., 2)."""
    share = dot(point - centre, half) / (dot(half, half) + TINY)
    return centre + jnp.clip(share, -1.0, 1.0)[..., None] * half


def contact(
    centre_i: jax.Array,
    half_i: jax.Array,
    radius_i: jax.Array,
    centre_j: jax.Array,
    half_j: jax.Array,
    radius_j: jax.Array,
) -> Contact:
    """The nearest places of objects i and j. Axes that cross are not told apart from axes whose ends are near.

    Args:
        centre_i: (..., 2) px, as for j; all axes in front are broadcast.
        half_i: (..., 2) px, from the centre to an end of the axis; zero for balls.
        radius_i: (...) px.
        centre_j: (..., 2) px.
        half_j: (..., 2) px.
        radius_j: (...) px.
    """
    centre_i, half_i, centre_j, half_j = jnp.broadcast_arrays(centre_i, half_i, centre_j, half_j)
    own = [centre_i + half_i, centre_i - half_i]
    other = [centre_j + half_j, centre_j - half_j]
    on_i = jnp.stack([*own, *(nearest_on(point, centre_i, half_i) for point in other)], axis=-2)
    on_j = jnp.stack([*(nearest_on(point, centre_j, half_j) for point in own), *other], axis=-2)
    apart = jax.lax.stop_gradient(jnp.square(on_i - on_j).sum(axis=-1))
    first = jax.nn.one_hot(apart.argmin(axis=-1), 4)[..., None]
    point_i, point_j = (on_i * first).sum(axis=-2), (on_j * first).sum(axis=-2)
    moved = jnp.square(on_i - jax.lax.stop_gradient(point_i)[..., None, :]).sum(axis=-1)
    others = jnp.where(moved < SAME_POINT**2, FAR**2, apart)
    second = jax.nn.one_hot(others.argmin(axis=-1), 4)[..., None]
    away = length(point_i - point_j)
    normal = (point_i - point_j) / away[..., None]
    both = radius_i + radius_j
    second_i, second_j = (on_i * second).sum(axis=-2), (on_j * second).sum(axis=-2)
    second_gap = jnp.where(others.min(axis=-1) >= FAR**2, FAR, length(second_i - second_j) - both)
    return Contact(
        gap=away - both,
        normal=normal,
        tangent=perpendicular(normal),
        arm_i=point_i - normal * jnp.asarray(radius_i)[..., None] - centre_i,
        arm_j=point_j + normal * jnp.asarray(radius_j)[..., None] - centre_j,
        second_gap=second_gap,
        second_arm=second_i - centre_i,
    )

"""Plane vectors whose float64 arithmetic rounds like the reference's.

A compiler may contract ``x * y + z`` into one fused multiply-add, which rounds once. The reference's binaries round the
product, then the sum. So every product that the solver adds to something goes through `product`. Only this file knows
how the contraction is prevented.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp


def is_exact(like: jax.Array) -> bool:
    """Return whether arithmetic must round as the reference's (float64), or may be more accurate (float32)."""
    return like.dtype == jnp.float64


def rounded(value: jax.Array) -> jax.Array:
    """Return `value` unchanged, as a rounding point that no compiler pass sees through (float64 only).

    A select between product and sum stops the contraction; barriers and bit casts do not. NaN stays NaN. In float32
    there is no parity to the last bit, so the compiler may contract.
    """
    return jnp.where(value == value, value, jnp.nan) if is_exact(value) else value


def product(x: jax.Array, y: jax.Array) -> jax.Array:
    """Return x * y, rounded before anything is added to it."""
    return rounded(x * y)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Vec:
    """A plane vector, or rows of them: two arrays of one shape, px or px/s, y down."""

    x: jax.Array
    y: jax.Array

    def __add__(self, other: Vec) -> Vec:
        return Vec(self.x + other.x, self.y + other.y)

    def __sub__(self, other: Vec) -> Vec:
        return Vec(self.x - other.x, self.y - other.y)

    def __neg__(self) -> Vec:
        return Vec(-self.x, -self.y)

    def __mul__(self, factor: jax.Array) -> Vec:
        return Vec(product(self.x, factor), product(self.y, factor))

    @property
    def exact(self) -> bool:
        """Whether arithmetic with it rounds as the reference's, see `is_exact`."""
        return is_exact(self.x)

    def __getitem__(self, index: object) -> Vec:
        return jax.tree.map(lambda leaf: leaf[index], self)


def dot(a: Vec, b: Vec) -> jax.Array:
    """Return a . b."""
    return product(a.x, b.x) + product(a.y, b.y)


def cross(a: Vec, b: Vec) -> jax.Array:
    """Return a_x b_y - a_y b_x."""
    return product(a.x, b.y) - product(a.y, b.x)


def perp(a: Vec) -> Vec:
    """Return `a` turned by a right angle: (-a_y, a_x)."""
    return Vec(-a.y, a.x)


def rotate(a: Vec, b: Vec) -> Vec:
    """Return the complex product of `a` and `b`; with a unit vector `a`, `b` turned into its frame."""
    return Vec(product(a.x, b.x) - product(a.y, b.y), product(a.x, b.y) + product(a.y, b.x))


def lerp(a: Vec, b: Vec, t: jax.Array) -> Vec:
    """Return a (1 - t) + b t, in this form (the other form rounds differently)."""
    return a * (1.0 - t) + b * t


def length(a: Vec) -> jax.Array:
    """Return |a| as the root of the sum of squares."""
    return rounded(jnp.sqrt(dot(a, a)))


def normalized(a: Vec) -> Vec:
    """Return a / (|a| + tiny): the zero vector for a zero vector, tiny being the dtype's smallest normal number."""
    return a * (1.0 / (length(a) + jnp.finfo(a.x.dtype).tiny))


def clamp01(t: jax.Array) -> jax.Array:
    """Return t limited to [0, 1]."""
    return jnp.maximum(jnp.zeros_like(t), jnp.minimum(t, jnp.ones_like(t)))


def where(mask: jax.Array, a: Vec, b: Vec) -> Vec:
    """Select `a` where `mask`, else `b`."""
    return Vec(jnp.where(mask, a.x, b.x), jnp.where(mask, a.y, b.y))

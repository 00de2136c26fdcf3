"""One contact of the solver: how fast its bodies move there, and what an impulse there does to them.

Which two bodies touch differs from lane to lane. So a contact holds two things for every moving body: a sign (-1 for
the first body, 1 for the second, 0 for the others) and the body's arm times that sign. All masses are 1. Then the
relative velocity is sum(sign v + perp(arm) w), and an impulse j changes v by sign j and w by cross(arm, j) / I. No body
has to be selected. A product with a sign is exact, so everything rounds as in the reference.

In float64 arms are in the world frame, as in the reference; in float32 in the contact's frame, normal and tangent. That
halves the work for a ball: its arm lies along the normal, so a push along the normal does not turn it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax

from iphyre_jax.physics import lanes
from iphyre_jax.physics.types import Motions, World
from iphyre_jax.physics.vector import Vec, cross, dot, perp, product, rotate

COMMON = 6  # columns before the signs and arms


@dataclass(frozen=True)
class ContactLayout:
    """Which columns a packed contact has; static."""

    bars: int  # moving bars
    moving: int  # moving bodies
    exact: bool  # rounded as the reference's

    @property
    def signs(self) -> bool:
        """Whether there are signs; without them only one body moves, which is always the first."""
        return self.moving > 1

    @property
    def has_tangent_arm(self) -> tuple[bool, ...]:
        """For each moving body whether its arm has a second component: only a ball's in the contact's frame has not."""
        return tuple(self.exact or body < self.bars for body in range(self.moving))

    @property
    def width(self) -> int:
        """Number of columns."""
        return COMMON + self.moving * (1 + self.signs) + sum(self.has_tangent_arm)


@dataclass(frozen=True)
class Arm:
    """A vector from a body's centre to the contact, times the body's sign, px."""

    x: jax.Array
    y: jax.Array | None  # None for zero

    def cross(self, vec: Vec) -> jax.Array:
        """Return arm x vec."""
        return product(self.x, vec.y) if self.y is None else cross(Vec(self.x, self.y), vec)

    def turned(self, angular_velocity: jax.Array, onto: Vec) -> Vec:
        """Return onto + perp(arm) * angular velocity, the velocity at the contact."""
        x = onto.x if self.y is None else onto.x - product(self.y, angular_velocity)
        return Vec(x, onto.y + product(self.x, angular_velocity))


@dataclass(frozen=True)
class Contact:
    """A contact point as the sweeps see it."""

    normal: Vec
    normal_mass: jax.Array
    tangent_mass: jax.Array
    bias: jax.Array  # px/s, wanted speed of separation along the normal
    bounce: jax.Array  # px/s
    sign: tuple[jax.Array, ...]  # one a moving body, none without signs
    arm: tuple[Arm, ...]  # one a moving body

    def pack(self) -> jax.Array:
        """Return the fields as rows of one array."""
        own = [self.normal.x, self.normal.y, self.normal_mass, self.tangent_mass, self.bias, self.bounce]
        arms = [part for arm in self.arm for part in (arm.x, arm.y) if part is not None]
        return lanes.stack([*own, *self.sign, *arms])


def layout_of(world: World) -> ContactLayout:
    """Return the layout of a world's contacts."""
    return ContactLayout(world.bar_a.x.shape[0], world.start.x.shape[0], world.exact)


def unpack_contact(packed: jax.Array, layout: ContactLayout, axis: int = 0) -> Contact:
    """Return a packed contact, or with axis 1 a whole table of them, by the names of its fields."""
    n = [jax.lax.index_in_dim(packed, k, axis, keepdims=False) for k in range(layout.width)]
    signs, arms = [n.pop(COMMON) for _ in range(layout.moving) if layout.signs], n[COMMON:]
    vectors = [Arm(arms.pop(0), arms.pop(0) if tangent else None) for tangent in layout.has_tangent_arm]
    return Contact(Vec(n[0], n[1]), n[2], n[3], n[4], n[5], tuple(signs), tuple(vectors))


def relative_velocity(contact: Contact, motions: Motions, *, bias: bool = False) -> Vec:
    """Return the velocity (or bias velocity) of the second body relative to the first, there: normal, tangential."""
    velocities = [motion.bias_velocity if bias else motion.velocity for motion in motions]
    angular_velocities = [motion.bias_angular_velocity if bias else motion.angular_velocity for motion in motions]
    own = [_times(contact, k, velocity) for k, velocity in enumerate(velocities)]
    if contact.normal.exact:
        at = [
            arm.turned(angular_velocity, vec)
            for arm, angular_velocity, vec in zip(contact.arm, angular_velocities, own, strict=True)
        ]
        return _in_frame(contact, _sum(at))
    total = _in_frame(contact, _sum(own))
    for arm, angular_velocity in zip(contact.arm, angular_velocities, strict=True):
        total = arm.turned(angular_velocity, total)
    return total


def apply_impulse(
    world: World, contact: Contact, motions: Motions, impulse: Vec, push: jax.Array | None = None
) -> Motions:
    """Give the bodies an impulse (normal, tangential), and a bias impulse along the normal, px/s."""
    exact = contact.normal.exact
    whole = rotate(contact.normal, impulse)
    whole_push = None if push is None else contact.normal * push
    out = []
    for k, (motion, arm) in enumerate(zip(motions, contact.arm, strict=True)):
        spin = motion.angular_velocity + product(world.inv_moment[k], arm.cross(whole if exact else impulse))
        motion = replace(motion, velocity=motion.velocity + _times(contact, k, whole), angular_velocity=spin)
        if push is not None and whole_push is not None:
            motion = replace(motion, bias_velocity=motion.bias_velocity + _times(contact, k, whole_push))
            if exact:
                turn = product(world.inv_moment[k], arm.cross(whole_push))
                motion = replace(motion, bias_angular_velocity=motion.bias_angular_velocity + turn)
            elif arm.y is not None:
                turn = product(world.inv_moment[k], product(arm.y, push))
                motion = replace(motion, bias_angular_velocity=motion.bias_angular_velocity - turn)
        out.append(motion)
    return out


def _times(contact: Contact, body: int, vec: Vec) -> Vec:
    """Return the sign of a body times a vector; this is exact."""
    if not contact.sign:
        return -vec
    return Vec(contact.sign[body] * vec.x, contact.sign[body] * vec.y)


def _sum(vectors: list[Vec]) -> Vec:
    total = vectors[0]
    for vec in vectors[1:]:
        total = total + vec
    return total


def _in_frame(contact: Contact, vec: Vec) -> Vec:
    """Return a vector's components along the contact's normal and tangent."""
    return Vec(dot(vec, contact.normal), dot(vec, perp(contact.normal)))

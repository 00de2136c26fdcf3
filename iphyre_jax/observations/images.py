"""Observations as images."""

from __future__ import annotations

from typing import cast

import jax
import jax.numpy as jnp

from iphyre_jax.observations.drawing import Drawing, colours, draw, painting_order
from iphyre_jax.observations.features import Features, Pose, object_table


def image(features: Features, pose: Pose, size: int) -> jax.Array:
    """Return the picture of a world, (size, size, 3) uint8; white for a world that is no longer finite."""
    return jnp.where(pose.sound, draw(drawing_of(features, pose), size), jnp.full((), 255, jnp.uint8))


def drawing_of(features: Features, pose: Pose) -> Drawing:
    """Return the content of a picture of a world."""
    table, present = object_table(features, pose), pose.present
    start = cast(jax.Array, features.object_rows)
    ball = (start[:, 0] == start[:, 2]) & (start[:, 1] == start[:, 3])  # no bar is so short
    centre = jnp.stack([(table[:, 0] + table[:, 2]) / 2, (table[:, 1] + table[:, 3]) / 2], axis=1)
    spokes, spoke_length = _spokes(features, start[:, 4], ball, pose)
    joints, joint_present = _links(features.joints, centre, present)
    springs, spring_present = _links(features.springs, centre, present)
    order = painting_order(start[:, 6] > 0)
    return Drawing(
        ends=table[order, :4],
        radius=start[order, 4],
        colour=colours(ball, start[:, 5] > 0, start[:, 6] > 0)[order],
        present=present[order],
        spokes=spokes,
        spoke_length=spoke_length,
        joints=joints,
        springs=springs,
        joint_present=joint_present,
        spring_present=spring_present,
    )


def _spokes(features: Features, radius: jax.Array, ball: jax.Array, pose: Pose) -> tuple[jax.Array, jax.Array]:
    """Return the radii that show the balls' angles, (n, 4) px, and their lengths, 0 for bars."""
    index = jnp.arange(ball.shape[0], dtype=jnp.int32)
    spokes, lengths = [], []
    for body in range(features.mover.shape[0]):
        x, y, angle = pose.x[body], pose.y[body], pose.angle[body]
        here = (index == features.mover[body]) & ball
        length = jnp.sum(jnp.where(here, radius, 0))
        spokes.append(jnp.stack([x, y, x + length * jnp.cos(angle), y + length * jnp.sin(angle)]))
        lengths.append(length)
    return jnp.stack(spokes), jnp.stack(lengths)


def _links(pairs: jax.Array, centre: jax.Array, present: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the ends of the links between pairs of objects, (L, 4) px, and which links are present, (L,)."""
    ends = jnp.zeros((pairs.shape[0], 4), centre.dtype)
    if not pairs.shape[0]:
        return ends, jnp.zeros(0, bool)
    first = jnp.argmax(pairs, axis=1)
    last = pairs.shape[1] - 1 - jnp.argmax(pairs[:, ::-1], axis=1)
    ends = jnp.concatenate([centre[first], centre[last]], axis=1)
    return ends, jnp.any(pairs, axis=1) & ~jnp.any(pairs & ~present[None, :], axis=1)

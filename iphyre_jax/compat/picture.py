"""The picture of a `SteppedWorld`."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.compat.world import SteppedWorld
from iphyre_jax.observations.drawing import Drawing, colours, draw, painting_order

SIZE = 600  # px


def picture(world: SteppedWorld) -> npt.NDArray[np.uint8]:
    """Return the picture of a world, (600, 600, 3) uint8 in red, green, blue."""
    scene, features = world.scene, world.features
    position, angle = world.poses()
    table = world.table()
    balls = np.arange(scene.n_blocks, scene.n_objects)
    radius = np.array(features.constants[:, 0])
    is_ball = np.isin(np.arange(len(radius)), balls)
    edge = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius[:, None]
    links = [np.array([[*position[i], *position[j]] for i, j in pairs]).reshape(-1, 4) for pairs in _pairs(world)]
    present = [np.array([world.alive[i] and world.alive[j] for i, j in pairs], bool) for pairs in _pairs(world)]
    dynamic = jnp.asarray(features.constants[:, 2] > 0)
    order = painting_order(dynamic)
    drawing = Drawing(
        ends=jnp.asarray(table[:, :4])[order],
        radius=jnp.asarray(radius)[order],
        colour=colours(jnp.asarray(is_ball), jnp.asarray(features.constants[:, 1] > 0), dynamic)[order],
        present=jnp.asarray(world.alive)[order],
        spokes=jnp.asarray(np.concatenate([position, position + edge], axis=1)[balls]),
        spoke_length=jnp.asarray(radius[balls]),
        joints=jnp.asarray(links[0]),
        springs=jnp.asarray(links[1]),
        joint_present=jnp.asarray(present[0]),
        spring_present=jnp.asarray(present[1]),
    )
    return np.asarray(draw(drawing, SIZE))


def _pairs(world: SteppedWorld) -> tuple[Sequence[tuple[int, int]], Sequence[tuple[int, int]]]:
    return world.scene.joints, world.scene.springs

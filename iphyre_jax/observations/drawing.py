"""Pictures of a world, drawn in JAX at any size, as the official class shows it.

Colours and marks are those of pymunk's debug view, which the official class uses: red balls with a dark radius that
shows their angle, grey blocks that can be eliminated, black ones that cannot, blue ones that move, purple lines with
dots for pin joints and a zigzag for springs. Edges are anti-aliased. Contact points, which that view marks with short
lines, are not drawn. Colours are red, green, blue, as on the screen; the arrays of the official class have red and blue
swapped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

import jax
import jax.numpy as jnp

from iphyre_jax.rules import SCREEN

BALL: Final = (255, 0, 0)
ELIMINABLE: Final = (164, 164, 164)
FIXED: Final = (0, 0, 0)
MOVING: Final = (52, 152, 219)
RADIUS_LINE: Final = (44, 62, 80)
LINK: Final = (142, 68, 173)

LINK_DOT: Final = 5.0  # px, radius of the dots at a link's ends
LINE: Final = 0.5  # px, half the width of a line
THICK_FROM: Final = 20.0  # px, radius of the balls above which the radius line is twice as wide
COILED: Final = 0.6  # share of a spring's length that is zigzag
COIL_PERIOD: Final = 0.1  # share of its length from one crest to the next
SPRING_SWING: Final = 6.0  # px, height of a crest


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Drawing:
    """The content of a picture: N objects in the order of painting, J joints, P springs, lengths in px of the scene."""

    ends: jax.Array  # (N, 4) x1, y1, x2, y2; the centre twice for a ball
    radius: jax.Array  # (N,)
    colour: jax.Array  # (N, 3) 0 to 255
    present: jax.Array  # (N,) bool
    spokes: jax.Array  # (S, 4) a radius of each ball at its angle: x, y of centre and edge
    spoke_length: jax.Array  # (S,) the balls' radii, 0 for none
    joints: jax.Array  # (J, 4) x1, y1, x2, y2
    springs: jax.Array  # (P, 4)
    joint_present: jax.Array  # (J,) bool
    spring_present: jax.Array  # (P,) bool


def colours(ball: jax.Array, eliminable: jax.Array, dynamic: jax.Array) -> jax.Array:
    """Return the objects' colours, (N, 3) float32, from flags (N,) bool."""
    kinds = [jnp.asarray(kind, jnp.float32) for kind in (BALL, ELIMINABLE, MOVING, FIXED)]
    pick = jnp.select([ball, eliminable, dynamic], [jnp.full(ball.shape, k, jnp.int32) for k in range(3)], 3)
    return jnp.stack(kinds)[pick]


def painting_order(dynamic: jax.Array) -> jax.Array:
    """Return the order of painting, (N,) int32: the official view paints static objects over moving ones."""
    return jnp.argsort(~dynamic, stable=True).astype(jnp.int32)


@partial(jax.jit, static_argnums=1)
def draw(drawing: Drawing, size: int) -> jax.Array:
    """Draw one world.

    Args:
        drawing: its content.
        size: px, side of the picture, which shows the scene from 0 to 600 px in both directions.

    Returns:
        (size, size, 3) uint8; row 0 is the top, y = 0.
    """
    drawing = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), drawing)
    scale = SCREEN / size
    # The official picture has the point (x, y) in the middle of pixel (x, y).
    at = (jnp.arange(size, dtype=jnp.float32) + 0.5) * scale - 0.5
    canvas = _Canvas(at[None, :], at[:, None], scale)
    picture = [jnp.full((size, size), 255.0, jnp.float32)] * 3
    for i in range(drawing.radius.shape[0]):
        inside = canvas.capsule(drawing.ends[i], drawing.radius[i] + 0.5)  # the border pixel belongs to it
        picture = _paint(picture, inside * drawing.present[i], drawing.colour[i])
    for i in range(drawing.spokes.shape[0]):
        wide = jnp.where(drawing.spoke_length[i] > THICK_FROM, 2 * LINE, LINE)
        line = canvas.capsule(drawing.spokes[i], wide) * (drawing.spoke_length[i] > 0).astype(jnp.float32)
        picture = _paint(picture, line, jnp.asarray(RADIUS_LINE, jnp.float32))
    link = jnp.asarray(LINK, jnp.float32)
    for ends, present in zip(drawing.joints, drawing.joint_present, strict=True):
        picture = _paint(picture, jnp.maximum(canvas.capsule(ends, LINE), canvas.dots(ends)) * present, link)
    for ends, present in zip(drawing.springs, drawing.spring_present, strict=True):
        picture = _paint(picture, jnp.maximum(canvas.spring(ends), canvas.dots(ends)) * present, link)
    return jnp.rint(jnp.stack(picture, axis=-1)).astype(jnp.uint8)


def _paint(picture: list[jax.Array], alpha: jax.Array, colour: jax.Array) -> list[jax.Array]:
    """Blend a colour (3,) over the three planes (H, W) of a picture where alpha (H, W) is above 0."""
    return [plane + alpha * (part - plane) for plane, part in zip(picture, colour, strict=True)]


@dataclass(frozen=True)
class _Canvas:
    """The pixel centres, px of the scene; its methods return how much of each pixel a shape covers, (H, W)."""

    x: jax.Array  # (1, W)
    y: jax.Array  # (H, 1)
    scale: float  # px of the scene in one of the picture

    def capsule(self, ends: jax.Array, radius: jax.Array | float) -> jax.Array:
        """Return the cover of all points within `radius` of the line between two points (4,)."""
        dx, dy = ends[2] - ends[0], ends[3] - ends[1]
        size = dx * dx + dy * dy
        per_size = 1.0 / jnp.where(size > 0, size, 1.0)
        x, y = self.x - ends[0], self.y - ends[1]
        along = (x * (dx * per_size) + y * (dy * per_size)).clip(0.0, 1.0)
        away_x, away_y = x - along * dx, y - along * dy
        return self._cover(jnp.sqrt(away_x * away_x + away_y * away_y), radius)

    def dots(self, ends: jax.Array) -> jax.Array:
        """Return the cover of the two ends of a link (4,)."""
        first, last = ends[:2], ends[2:]
        around = [self.capsule(jnp.concatenate([point, point]), LINK_DOT) for point in (first, last)]
        return jnp.maximum(*around)

    def spring(self, ends: jax.Array) -> jax.Array:
        """Return the cover of a zigzag between two points (4,), straight at its ends."""
        dx, dy = ends[2] - ends[0], ends[3] - ends[1]
        length = jnp.sqrt(dx * dx + dy * dy)
        unit_x, unit_y = dx / jnp.where(length > 0, length, 1.0), dy / jnp.where(length > 0, length, 1.0)
        x, y = self.x - ends[0], self.y - ends[1]
        along = (x * unit_x + y * unit_y) / jnp.where(length > 0, length, 1.0)  # 0 at one end, 1 at the other
        across = y * unit_x - x * unit_y
        wave = jnp.abs((along / COIL_PERIOD + 0.25) % 1.0 - 0.5) * 4.0 - 1.0  # a triangle between -1 and 1
        coiled = jnp.abs(along - 0.5) <= COILED / 2
        slope = 4.0 * SPRING_SWING / (COIL_PERIOD * jnp.maximum(length, 1.0))
        apart = jnp.abs(across - jnp.where(coiled, wave * SPRING_SWING, 0.0))
        apart = apart / jnp.where(coiled, jnp.sqrt(1.0 + slope * slope), 1.0)
        return jnp.where((along >= 0) & (along <= 1), self._cover(apart, LINE), 0.0)

    def _cover(self, apart: jax.Array, radius: jax.Array | float) -> jax.Array:
        """Return the cover of points nearer than `radius`; shapes thinner than a pixel fade."""
        return (0.5 + (radius - apart) / self.scale).clip(0.0, 1.0) * jnp.minimum(1.0, 2.0 * radius / self.scale)

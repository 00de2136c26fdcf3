"""Draw frames with Pillow, fast enough for films.

`iphyre_jax.observations.drawing` draws in JAX, for observations inside compiled code. This module draws the same
shapes at twice the size and shrinks the picture, which smooths the edges. It draws static blocks only once, and it
knows themes and trails.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import missing_extra
from iphyre_jax.observations import drawing
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import Scene
from iphyre_jax.viewer.themes import Colour, Theme

try:
    from PIL import Image, ImageDraw, ImageFont
except ModuleNotFoundError as error:
    raise missing_extra(__name__, "viewer", error.name) from None

SUPERSAMPLING = 2  # factor by which pictures are drawn larger and then shrunk, which smooths the edges
OUTLINE = 1.6  # px of the scene
GRID = 100  # px of the scene
CREST = drawing.SPRING_SWING  # px of the scene, height of the zigzag of a spring

Point = tuple[float, float]
Floats = npt.NDArray[np.floating]


@cache
def font(size: int, *, ascii_only: bool = True) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font that comes with Pillow, or for more letters than ASCII matplotlib's, if it is installed."""
    found = None if ascii_only else find_spec("matplotlib")
    if found is None or found.origin is None:
        return ImageFont.load_default(size)
    return ImageFont.truetype(Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf", size)


def blend(colour: Colour, background: Colour, opacity: float) -> Colour:
    """Mix a colour with its background; an opacity of 1 gives the colour itself."""
    red, green, blue = (round(g + opacity * (c - g)) for c, g in zip(colour, background, strict=True))
    return red, green, blue


@dataclass
class Painter:
    """Draws frames of one scene, size x size pixels.

    Args:
        scene: the scene to draw.
        theme: its colours.
        size: px, side of the picture, which shows 600 px of the scene.
    """

    scene: Scene
    theme: Theme
    size: int
    _cached_static_layer: tuple[tuple[bool, ...], Image.Image] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        """Compute what stays the same in all frames."""
        scene, theme = self.scene, self.theme
        self._scale = self.size * SUPERSAMPLING / SCREEN
        centres = (scene.blocks[:, :1] + scene.blocks[:, 1:]) / 2
        self._arms = scene.blocks - centres  # (n_blocks, 2, 2) px, end points about the centre at angle 0
        kinds = zip(scene.eliminable[: scene.n_blocks], scene.dynamic[: scene.n_blocks], strict=True)
        self._colours = [theme.eliminable if e else theme.moving if d else theme.fixed for e, d in kinds]

    def paint(
        self,
        poses: Floats,
        present: Sequence[bool] | npt.NDArray[np.bool_],
        *,
        fading: dict[int, float] | None = None,
        trails: Sequence[Floats] = (),
    ) -> Image.Image:
        """Draw one frame.

        Args:
            poses: (N, 3) x, y (px) and angle (rad) of every object.
            present: (N,) whether each object is still there.
            fading: opacity, 0 to 1, of objects that were removed a moment ago.
            trails: the points (T, 2) of each trail, px, oldest first.
        """
        scene = self.scene
        image = self._static_layer(tuple(bool(t) for t in present[: scene.n_blocks])).copy()
        pen = ImageDraw.Draw(image)
        for block, opacity in (fading or {}).items():
            self._bar(pen, block, poses[block], opacity)
        for points in trails:
            self._trail(pen, points)
        for i in range(scene.n_blocks):
            if scene.dynamic[i]:
                self._bar(pen, i, poses[i])
        for i in range(scene.n_blocks, scene.n_objects):
            self._ball(pen, i, poses[i])
        # A dot never hides the ball that it sits on, but where the picture is the official one.
        dots = np.full(scene.n_objects, drawing.LINK_DOT)
        if self.theme.outlined:
            dots[scene.n_blocks :] = np.minimum(drawing.LINK_DOT, scene.balls[:, 2] / 2)
        joints, springs = (scene.joints, self.theme.joint, False), (scene.springs, self.theme.spring, True)
        for pairs, colour, coiled in (joints, springs):
            for i, j in pairs:
                if present[i] and present[j]:
                    self._link(pen, poses[[i, j], :2], dots[[i, j]], colour, coiled=coiled)
        return image.reduce(SUPERSAMPLING)

    def _static_layer(self, present: tuple[bool, ...]) -> Image.Image:
        """Return background and static blocks; they are drawn again only after a removal."""
        if self._cached_static_layer is None or self._cached_static_layer[0] != present:
            side = self.size * SUPERSAMPLING
            image = Image.new("RGB", (side, side), self.theme.background)
            pen = ImageDraw.Draw(image)
            if self.theme.outlined:
                for at in range(GRID, int(SCREEN), GRID):
                    place = at * self._scale
                    pen.line([(place, 0), (place, side)], self.theme.grid, SUPERSAMPLING)
                    pen.line([(0, place), (side, place)], self.theme.grid, SUPERSAMPLING)
            for i, there in enumerate(present):
                if there and not self.scene.dynamic[i]:
                    centre = (self.scene.blocks[i, 0] + self.scene.blocks[i, 1]) / 2
                    self._bar(pen, i, np.array([*centre, 0.0]))
            self._cached_static_layer = present, image
        return self._cached_static_layer[1]

    def _pixel(self, x: float, y: float) -> Point:
        """Return the place of a point of the scene in the large picture; (0, 0) is the centre of the first pixel."""
        shift = 0.5 * self.size * SUPERSAMPLING / SCREEN - 0.5
        return float(x) * self._scale + shift, float(y) * self._scale + shift

    def _bar(self, pen: ImageDraw.ImageDraw, block: int, pose: Floats, opacity: float = 1.0) -> None:
        """Draw a bar: all points within its radius of the segment between its ends."""
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        ends = [(pose[0] + x * cos - y * sin, pose[1] + x * sin + y * cos) for x, y in self._arms[block]]
        background, radius = self.theme.background, BAR_RADIUS + 0.5
        colour = self._colours[block]
        if self.theme.outlined and self.scene.eliminable[block]:
            self._capsule(pen, ends, radius, blend(self.theme.edge, background, opacity))
            radius -= OUTLINE
        self._capsule(pen, ends, radius, blend(colour, background, opacity))

    def _capsule(self, pen: ImageDraw.ImageDraw, ends: Sequence[Point], radius: float, colour: Colour) -> None:
        (ax, ay), (bx, by) = (self._pixel(*end) for end in ends)
        r, length = radius * self._scale, math.hypot(bx - ax, by - ay)
        if length > 0:
            nx, ny = -(by - ay) / length * r, (bx - ax) / length * r
            pen.polygon([(ax + nx, ay + ny), (bx + nx, by + ny), (bx - nx, by - ny), (ax - nx, ay - ny)], fill=colour)
        for x, y in ((ax, ay), (bx, by)):
            pen.ellipse((x - r, y - r, x + r, y + r), fill=colour)

    def _ball(self, pen: ImageDraw.ImageDraw, index: int, pose: Floats) -> None:
        """Draw a ball and the line that shows its angle."""
        radius = float(self.scene.balls[index - self.scene.n_blocks, 2])
        here = [(pose[0], pose[1])] * 2
        if self.theme.outlined:
            self._capsule(pen, here, radius + 0.5, self.theme.edge)
        self._capsule(pen, here, radius + 0.5 - OUTLINE * self.theme.outlined, self.theme.ball)
        reach = radius if not self.theme.outlined else radius - OUTLINE
        tip = pose[0] + reach * math.cos(pose[2]), pose[1] + reach * math.sin(pose[2])
        width = 2 if radius > drawing.THICK_FROM or self.theme.outlined else 1
        pen.line([self._pixel(*here[0]), self._pixel(*tip)], self.theme.spoke, max(1, round(width * self._scale)))

    def _link(self, pen: ImageDraw.ImageDraw, ends: Floats, dots: Floats, colour: Colour, *, coiled: bool) -> None:
        """Draw a joint as a line, a spring as a zigzag, both with dots at their ends (2, 2); dots: radii (2,), px."""
        first, last = ends
        width = max(1, round((2 if self.theme.outlined else 1) * self._scale))
        points = _zigzag(first, last) if coiled else [(first[0], first[1]), (last[0], last[1])]
        pen.line([self._pixel(*point) for point in points], colour, width, joint="curve")
        for (x, y), radius in zip(ends, dots, strict=True):
            self._capsule(pen, [(x, y)] * 2, radius, colour)

    def _trail(self, pen: ImageDraw.ImageDraw, points: Floats) -> None:
        """Draw the path of a ball; older parts are fainter."""
        count, width = len(points) - 1, max(1, round(3 * self._scale))
        for k in range(count):
            colour = blend(self.theme.ball, self.theme.background, 0.08 + 0.42 * (k + 1) / count)
            pen.line([self._pixel(*points[k]), self._pixel(*points[k + 1])], colour, width)


def _zigzag(first: Floats, last: Floats) -> list[Point]:
    """Return the corners of a spring between two points; its ends are straight."""
    way = np.asarray(last, float) - np.asarray(first, float)
    length = float(np.hypot(*way))
    if length == 0:
        return [(first[0], first[1]), (last[0], last[1])]
    side = np.array([-way[1], way[0]]) / length
    begin = (1 - drawing.COILED) / 2
    crests = round(2 * drawing.COILED / drawing.COIL_PERIOD)
    places = begin + (np.arange(crests) + 0.5) * drawing.COIL_PERIOD / 2
    zigzag = ((p, -((-1.0) ** k)) for k, p in enumerate(places))
    corners = [(0.0, 0.0), (begin, 0.0), *zigzag, (1 - begin, 0.0), (1.0, 0.0)]
    spots = [first + way * along + side * CREST * across for along, across in corners]
    return [(float(x), float(y)) for x, y in spots]

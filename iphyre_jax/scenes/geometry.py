"""Gaps between objects, and how far objects stick out of the picture, for many layouts at once.

A layout is a pair of arrays, px: bars (B, n, 2, 2), end points, and balls (B, m, 3), x, y and radius. Objects are the
bars, then the balls. An object covers all points within its radius of its segment. The segment of a ball is a point.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import one_line
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes.scene import Scene

Floats = npt.NDArray[np.float64]

TOLERANCE: Final = 1e-6  # px; resting objects touch up to rounding


class Layouts(NamedTuple):
    """B layouts of one scene's objects."""

    bars: Floats  # (B, n, 2, 2) px
    balls: Floats  # (B, m, 3) px

    @classmethod
    def of(cls, scene: Scene, count: int = 1) -> Layouts:
        """Return `count` copies of a scene's layout."""
        return cls(np.repeat(scene.blocks[None], count, axis=0), np.repeat(scene.balls[None], count, axis=0))

    def ends(self) -> Floats:
        """Return the segment ends of all objects, (B, N, 2, 2) px; both ends of a ball are its centre."""
        return np.concatenate([self.bars, np.repeat(self.balls[:, :, None, :2], 2, axis=2)], axis=1)

    def radii(self) -> Floats:
        """Return the radii of all objects, (B, N) px."""
        return np.concatenate([np.full(self.bars.shape[:2], BAR_RADIUS), self.balls[:, :, 2]], axis=1)


def gaps(layouts: Layouts) -> Floats:
    """Return the gap between every two objects, (B, N, N) px: negative if they overlap, inf on the diagonal."""
    ends, radii = layouts.ends(), layouts.radii()
    own = np.eye(ends.shape[1], dtype=bool)
    return np.where(own, np.inf, gaps_between(ends, radii, ends, radii))


def gaps_between(ends: Floats, radii: Floats, other_ends: Floats, other_radii: Floats) -> Floats:
    """Return the gaps between k objects and n others of each of B layouts, (B, k, n) px: negative if they overlap.

    Args:
        ends: (B, k, 2, 2) px, the ends of the segments, as `Layouts.ends` returns them.
        radii: (B, k) px.
        other_ends: (B, n, 2, 2) px.
        other_radii: (B, n) px.
    """
    first, second = ends[:, :, None], other_ends[:, None, :]
    apart = np.minimum(_distances_to_segment(first, second), _distances_to_segment(second, first))
    apart = np.where(_segments_cross(first, second), 0.0, apart) - (radii[:, :, None] + other_radii[:, None, :])
    return np.asarray(apart)


def outside(layouts: Layouts) -> Floats:
    """Return how far each object sticks out of the picture, (B, N) px; 0 if it does not."""
    ends, radii = layouts.ends(), layouts.radii()[:, :, None]
    low = radii - ends.min(axis=2)
    high = ends.max(axis=2) + radii - SCREEN
    return np.maximum(np.maximum(low, high).max(axis=2), 0.0)


def scene_warnings(scene: Scene) -> list[str]:
    """List what is unusual about a valid scene: objects that overlap at the start or stick out of the picture.

    Returns:
        One line for each, "field[i]: ...".
    """
    layouts = Layouts.of(scene)
    names = [f"block[{i}]" for i in range(scene.n_blocks)] + [f"ball[{i}]" for i in range(scene.n_balls)]
    lines = [
        f"{names[i]}: sticks out of the picture by {far:g} px"
        for i, far in enumerate(outside(layouts)[0].tolist())
        if far > TOLERANCE
    ]
    between = gaps(layouts)[0]
    for i, j in np.argwhere(np.triu(between < -TOLERANCE)).tolist():
        lines.append(f"{names[j]}: overlaps {names[i]} by {-between[i, j]:g} px")
    return [one_line(line) for line in lines]


def _distances_to_segment(lines: Floats, points: Floats) -> Floats:
    """Return the smaller distance of two points (..., 2, 2) to a segment (..., 2, 2)."""
    start, way = lines[..., 0, :], lines[..., 1, :] - lines[..., 0, :]
    size = _dot_product(way, way)
    away = points - start[..., None, :]
    along = _dot_product(away, way[..., None, :]) / np.where(size > 0, size, 1.0)[..., None]
    rest = away - np.clip(along, 0.0, 1.0)[..., None] * way[..., None, :]
    distances = np.sqrt(_dot_product(rest, rest))
    return np.asarray(np.minimum(distances[..., 0], distances[..., 1]))


def _segments_cross(first: Floats, second: Floats) -> npt.NDArray[np.bool_]:
    """Return whether two segments (..., 2, 2) cross."""
    a, b = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    between = second[..., 0, :] - first[..., 0, :]
    turn = _cross_product(a, b)
    safe = np.where(turn == 0, 1.0, turn)
    t, u = _cross_product(between, b) / safe, _cross_product(between, a) / safe
    return np.asarray((turn != 0) & (t >= 0) & (t <= 1) & (u >= 0) & (u <= 1))


def _dot_product(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1])  # a sum over an axis of two is slow


def _cross_product(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

"""Charts as inline SVG. They use the page's style sheet, so that they follow light and dark mode."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.rules import SCREEN

Values = NDArray[np.floating]

LOW, HIGH = -14.0, 4.0  # powers of ten of the error scale, px; exact zero lies on the lower edge
DECADES = (-12, -9, -6, -3, 0, 3)


def log_height(errors: Values) -> NDArray[np.float64]:
    """Errors in px as heights from 0 (no error, or below the scale) to 1 (infinity); NaN stays NaN."""
    with np.errstate(divide="ignore"):
        power = np.log10(errors.astype(np.float64))
    return np.clip((power - LOW) / (HIGH - LOW), 0.0, 1.0)


def path(x: Values, y: Values, kind: str) -> str:
    """A line through points with a gap at each NaN."""
    words, pen = [], "M"
    for left, top in zip(x.tolist(), y.tolist(), strict=True):
        if np.isfinite(left) and np.isfinite(top):
            words.append(f"{pen}{left:.1f} {top:.1f}")
            pen = "L"
        else:
            pen = "M"
    return f'<path class="{kind}" d="{"".join(words)}"/>' if words else ""


def band(x: Values, low: Values, high: Values, kind: str) -> str:
    """The area between two lines where both have values."""
    valid = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    areas = []
    for run in np.split(valid, np.flatnonzero(np.diff(valid) > 1) + 1):
        outline = [*zip(x[run], high[run], strict=True), *zip(x[run][::-1], low[run][::-1], strict=True)]
        areas.append("M" + "L".join(f"{left:.1f} {top:.1f}" for left, top in outline) + "Z" if outline else "")
    return f'<path class="{kind}" d="{"".join(areas)}"/>' if any(areas) else ""


def error_chart(
    title: str, seconds: float, bands: Sequence[tuple[Values, Values, str]], lines: Sequence[tuple[Values, str]]
) -> str:
    """Errors over time on a logarithmic scale.

    Args:
        title: above the chart.
        seconds: length of the time axis.
        bands: lower and upper values and class of each area in the background.
        lines: values and class of each line.

    Returns:
        One SVG element.
    """
    left, top, width, height = 30.0, 18.0, 206.0, 104.0

    def x(values: Values) -> NDArray[np.float64]:
        return left + width * np.arange(len(values)) / max(len(values) - 1, 1)

    def y(values: Values) -> NDArray[np.float64]:
        return np.asarray(top + height * (1.0 - log_height(values)))

    parts = [f'<svg class="chart" viewBox="0 0 240 140" role="img" aria-label="{escape(title)}">']
    parts.append(f'<text class="name" x="{left}" y="11">{escape(title)}</text>')
    for power in DECADES:
        at = top + height * (1.0 - (power - LOW) / (HIGH - LOW))
        parts.append(f'<path class="grid" d="M{left} {at:.1f}h{width}"/>')
        parts.append(f'<text class="tick" x="{left - 3}" y="{at + 2.5:.1f}" text-anchor="end">1e{power}</text>')
    parts.append(f'<text class="tick" x="{left - 3}" y="{top + height + 2.5}" text-anchor="end">0</text>')
    for second in np.linspace(0, seconds, 4):
        at = left + width * second / seconds
        anchor = "end" if second == seconds else "middle"
        place = f'x="{at:.1f}" y="{top + height + 11}" text-anchor="{anchor}"'
        parts.append(f'<text class="tick" {place}>{second:g} s</text>')
    parts.append(f'<path class="axis" d="M{left} {top}v{height}h{width}"/>')
    parts += [band(x(high), y(low), y(high), kind) for low, high, kind in bands]
    parts += [path(x(values), y(values), kind) for values, kind in lines]
    return "".join([*parts, "</svg>"])


def sparkline(lines: Sequence[tuple[Values, str]], *, logarithmic: bool) -> str:
    """A small chart for a table's cell; a linear one is scaled to its values."""
    width, height = 96.0, 20.0
    drawn = []
    if logarithmic:
        heights = [(log_height(values), kind) for values, kind in lines]
        limit = height * (1.0 - (-6 - LOW) / (HIGH - LOW))
        drawn.append(f'<path class="grid" d="M0 {limit:.1f}h{width}"/>')
    else:
        everything = np.concatenate([values for values, _ in lines])
        low, high = float(np.min(everything)), float(np.max(everything))
        heights = [((values.astype(np.float64) - low) / (high - low or 1.0), kind) for values, kind in lines]
    for share, kind in heights:
        x = width * np.arange(len(share)) / max(len(share) - 1, 1)
        drawn.append(path(x, 1.0 + (height - 2.0) * (1.0 - share), kind))
    return f'<svg class="spark" viewBox="0 0 {width:g} {height:g}" aria-hidden="true">{"".join(drawn)}</svg>'


def trajectories(scene: Scene, reference: Values, ours: Values) -> str:
    """The paths of the moving objects in both engines, over the scene at its start.

    Args:
        scene: the scene.
        reference: (K, N, 3) poses.
        ours: (K, N, 3) poses.

    Returns:
        One SVG element.
    """
    parts = ['<svg class="scene" viewBox="-20 -20 640 640" role="img" aria-label="two plays of one plan">']
    parts.append(f'<rect class="frame" width="{SCREEN:g}" height="{SCREEN:g}"/>')
    for index in range(scene.n_objects):
        kind = "mover" if scene.dynamic[index] else "grey" if scene.eliminable[index] else "black"
        if index < scene.n_blocks:
            (x1, y1), (x2, y2) = scene.blocks[index].tolist()
            ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
            parts.append(f'<line class="bar {kind}" stroke-width="{2 * BAR_RADIUS:g}" {ends}/>')
        else:
            x, y, radius = scene.balls[index - scene.n_blocks].tolist()
            parts.append(f'<circle class="ball" cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>')
    for index in np.flatnonzero(scene.dynamic).tolist():
        for poses, kind in ((reference, "theirs"), (ours, "mine")):
            x, y = poses[:, index, 0], poses[:, index, 1]
            near = (np.abs(x - SCREEN / 2) < SCREEN) & (y > -SCREEN / 2) & (y < 1.2 * SCREEN)
            parts.append(path(np.where(near, x, np.nan), np.where(near, y, np.nan), kind))
    return "".join([*parts, "</svg>"])

"""Colours of pictures and pages: red, green and blue from 0 to 255.

`modern` and `dark` separate the kinds of objects by lightness and by blue against orange. People with any common form
of colour blindness can tell these apart (palette of Okabe and Ito; `tests/viewer/test_themes.py` measures it).
`official` has the colours of the official class, from `iphyre_jax.observations.drawing`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Final

from iphyre_jax.checks import check_option
from iphyre_jax.observations import drawing

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours of one look."""

    background: Colour
    grid: Colour
    ball: Colour
    eliminable: Colour
    fixed: Colour
    moving: Colour
    edge: Colour
    """Outline of balls and of eliminable blocks."""
    spoke: Colour
    """The line that shows the angle of a ball."""
    joint: Colour
    spring: Colour
    text: Colour
    quiet: Colour
    """Less important text."""
    solved: Colour
    failed: Colour
    contact: Colour
    velocity: Colour
    outlined: bool
    """Whether to draw outlines and a grid."""


THEMES: Final = MappingProxyType(
    {
        "modern": Theme(
            background=(250, 250, 248),
            grid=(234, 235, 234),
            ball=(213, 94, 0),
            eliminable=(176, 184, 195),
            fixed=(43, 48, 58),
            moving=(0, 114, 178),
            edge=(88, 97, 110),
            spoke=(255, 244, 232),
            joint=(136, 34, 102),
            spring=(136, 34, 102),
            text=(33, 37, 45),
            quiet=(98, 106, 118),
            solved=(0, 120, 92),
            failed=(160, 60, 0),
            contact=(136, 34, 102),
            velocity=(0, 114, 178),
            outlined=True,
        ),
        "dark": Theme(
            background=(24, 27, 33),
            grid=(38, 42, 50),
            ball=(240, 128, 40),
            eliminable=(112, 120, 132),
            fixed=(222, 226, 232),
            moving=(86, 180, 233),
            edge=(186, 194, 206),
            spoke=(40, 22, 4),
            joint=(224, 150, 196),
            spring=(224, 150, 196),
            text=(232, 235, 240),
            quiet=(156, 164, 176),
            solved=(64, 200, 160),
            failed=(244, 160, 90),
            contact=(240, 228, 66),
            velocity=(86, 180, 233),
            outlined=True,
        ),
        "official": Theme(
            background=(255, 255, 255),
            grid=(255, 255, 255),
            ball=drawing.BALL,
            eliminable=drawing.ELIMINABLE,
            fixed=drawing.FIXED,
            moving=drawing.MOVING,
            edge=drawing.RADIUS_LINE,
            spoke=drawing.RADIUS_LINE,
            joint=drawing.LINK,
            spring=drawing.LINK,
            text=(0, 0, 0),
            quiet=(90, 90, 90),
            solved=(0, 120, 92),
            failed=(160, 60, 0),
            contact=(142, 68, 173),
            velocity=(52, 152, 219),
            outlined=False,
        ),
    }
)


def theme(name: str) -> Theme:
    """Return a theme by its name.

    Raises:
        ValueError: there is no theme of this name.
    """
    return THEMES[check_option("theme", name, tuple(THEMES))]


def as_json() -> dict[str, dict[str, object]]:
    """Return all themes for the pages, with colours as "rgb(r, g, b)"."""
    return {
        name: {
            field: f"rgb({value[0]}, {value[1]}, {value[2]})" if isinstance(value, tuple) else value
            for field, value in asdict(theme).items()
        }
        for name, theme in THEMES.items()
    }

"""People with any common form of colour blindness can distinguish the default colours."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from iphyre_jax.viewer.themes import THEMES

# Machado, Oliveira, Fernandes 2009, severity 1: what a dichromat sees of linear RGB.
SEEN_BY = {
    "everybody": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
KINDS = ("background", "ball", "eliminable", "fixed", "moving")
CLEAR = 20.0  # CIE 1976 difference; 2.3 is just noticeable


def lab(colour: tuple[int, int, int], seen_by: str) -> np.ndarray:
    """Return the CIE Lab (D65) value of an sRGB colour, as a person with this colour vision sees it."""
    share = np.array(colour) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    linear = (SEEN_BY[seen_by] @ linear).clip(0, 1)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = (to_xyz @ linear) / np.array([0.95047, 1.0, 1.08883])
    fx, fy, fz = (v ** (1 / 3) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z))
    return np.array([116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)])


@pytest.mark.parametrize("seen_by", SEEN_BY)
@pytest.mark.parametrize("name", ["modern", "dark"])
def test_kinds_of_objects_differ_for_everybody(name: str, seen_by: str) -> None:
    for first, second in combinations(KINDS, 2):
        colours = (getattr(THEMES[name], kind) for kind in (first, second))
        apart = np.linalg.norm(np.subtract(*(lab(colour, seen_by) for colour in colours)))
        assert apart > CLEAR, f"{first} and {second}: {apart:.0f}"


@pytest.mark.parametrize("name", ["modern", "dark"])
@pytest.mark.parametrize("kind", ["text", "quiet", "solved", "failed"])
def test_text_can_be_read(name: str, kind: str) -> None:
    """WCAG 2 requires a contrast of 4.5."""

    def light(colour: tuple[int, int, int]) -> float:
        share = np.array(colour) / 255
        linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    dark, bright = sorted(light(getattr(THEMES[name], k)) for k in (kind, "background"))
    assert (bright + 0.05) / (dark + 0.05) >= 4.5

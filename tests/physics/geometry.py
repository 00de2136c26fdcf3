"""Points and bars as complex numbers in NumPy: what the tests of collision measure against."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.physics.types import Segment
from iphyre_jax.physics.vector import Vec

Complex = npt.NDArray[np.complex128]
Bars = tuple[Complex, Complex]  # both ends of each bar's core line, px


def vec(numbers: Any, dtype: str = "float64") -> Vec:
    """Return complex numbers as vectors."""
    return Vec(jnp.asarray(np.real(numbers), dtype), jnp.asarray(np.imag(numbers), dtype))


def number(value: Vec) -> Any:
    """Return vectors as complex numbers."""
    return np.asarray(value.x, np.float64) + 1j * np.asarray(value.y, np.float64)


def segment(bar: Bars, dtype: str = "float64") -> Segment:
    """Return bars as the solver has them: the normal is the way from a to b, turned by -90 degrees, as a unit."""
    a, b = bar
    return Segment(vec(a, dtype), vec(b, dtype), vec(-1j * (b - a) / (abs(b - a) + np.finfo(float).tiny), dtype))


def dot(a: Complex, b: Complex) -> npt.NDArray[np.float64]:
    """Return the scalar products of vectors."""
    return (a.conj() * b).real


def random_bars(count: int, seed: int, spread: float) -> tuple[Bars, Bars]:
    """Draw pairs of bars 10 to 120 px long whose centres lie within `spread` px of each other along each axis."""
    generator = np.random.default_rng(seed)

    def draw() -> Bars:
        centre = generator.uniform(-spread / 2, spread / 2, (2, count))
        half = generator.uniform(5, 60, count) * np.exp(1j * generator.uniform(-np.pi, np.pi, count))
        return centre[0] + 1j * centre[1] - half, centre[0] + 1j * centre[1] + half

    return draw(), draw()


def nearest_on(bar: Bars, point: Complex) -> Complex:
    """Return the point of each core line nearest to a point."""
    a, b = bar
    return a + (b - a) * np.clip(dot(b - a, point - a) / abs(b - a) ** 2, 0, 1)


def crossing(one: Bars, two: Bars) -> npt.NDArray[np.bool_]:
    """Return whether each bar's ends lie on different sides of the other."""

    def split(bar: Bars, other: Bars) -> npt.NDArray[np.bool_]:
        side = [((bar[1] - bar[0]).conj() * (end - bar[0])).imag for end in other]
        return np.sign(side[0]) != np.sign(side[1])

    return split(one, two) & split(two, one)


def shortest(one: Bars, two: Bars) -> Complex:
    """Return the shortest vector from the first core line to the second; they must not cross."""
    ways = [nearest_on(two, end) - end for end in one] + [end - nearest_on(one, end) for end in two]
    return np.choose(np.argmin(np.abs(ways), axis=0), ways)


def corners(one: Bars, two: Bars) -> Complex:
    """Return the corners of the difference sets by their codes, 2 * end of the first + end of the second."""
    return np.array([two[code & 1] - one[code >> 1] for code in range(4)])


def way_out(one: Bars, two: Bars) -> npt.NDArray[np.float64]:
    """Return the length of the shortest shift that frees two core lines that cross."""
    every = corners(one, two)
    edges = [(every[i], every[j]) for i, j in ((0, 1), (2, 3), (0, 2), (1, 3))]
    return np.min([abs(((b - a).conj() * a).imag) / abs(b - a) for a, b in edges], axis=0)

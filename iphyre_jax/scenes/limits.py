"""The limits of a valid scene, each with its unit and reason."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, cast

from iphyre_jax.checks import check_instance, show

MAX_OBJECTS: Final = 12  # rows of the official observation (IPHYREEnv.py)
MAX_ELIMINABLE: Final = 6  # entries of the official plan (IPHYREEnv.py)
MOST_OBJECTS: Final = 64  # of any scene; the contact order of the solver counts up to 63 static bars
MAX_MOVING: Final = 15  # moving bodies that the tag of a contact point can name
MAX_COORDINATE: Final = 10_000.0  # px; the screen has 600 px, and float32 resolves about 0.001 px at this distance
MIN_LENGTH: Final = 1e-3  # px; in float32 a shorter bar, radius or pin has no direction or no moment
MAX_NAME: Final = 100  # characters of a scene's name


@dataclass(frozen=True)
class Limits:
    """How many objects and eliminable blocks a scene may have: the rows of observations and the entries of plans.

    Attributes:
        objects: blocks and balls, 12 (the official number) to 64; at most 15 of them may move.
        blocks: eliminable blocks, 6 (the official number) to 64.

    Raises:
        ValueError: a number is out of range or not whole; one line.
    """

    objects: int = MAX_OBJECTS
    blocks: int = MAX_ELIMINABLE

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, least in (("objects", MAX_OBJECTS), ("blocks", MAX_ELIMINABLE)):
            value = getattr(self, name)
            if type(value) is not int or not least <= value <= MOST_OBJECTS:
                raise ValueError(
                    f"limits: {name}: expected a whole number from {least} to {MOST_OBJECTS}, got {show(value)}"
                )

    @classmethod
    def covering(cls, many: Iterable[Limits]) -> Limits:
        """Return the smallest limits that cover all the given ones, at least one."""
        objects, blocks = zip(*((one.objects, one.blocks) for one in many), strict=True)
        return cls(max(objects), max(blocks))


OFFICIAL: Final = Limits()


def check_limits(limits: object) -> Limits:
    """Return `limits`; ValueError in one line unless they are Limits."""
    return cast(Limits, check_instance("limits", limits, Limits, "Limits, such as Limits(objects=20, blocks=8)"))

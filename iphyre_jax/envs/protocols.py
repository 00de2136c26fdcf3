"""Rates of an episode: the paper's learning protocol, and the same decisions over finer physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from iphyre_jax.checks import check_resets, show, whole_fps
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES


@dataclass(frozen=True)
class EpisodeProtocol:
    """Rate of the physics; decisions come every 0.1 s at any rate.

    Attributes:
        name: for `make`.
        fps: physics steps a second, a multiple of 10.
        resets: number of the reset of the reused space; it decides the order of contacts.

    Raises:
        ValueError: a number is out of range; one line.
    """

    name: str
    fps: int
    resets: int

    def __post_init__(self) -> None:
        """Check the numbers, and make them `int`."""
        rate = whole_fps(self.fps)
        if rate % DECISIONS_PER_SECOND:
            raise ValueError(f"fps: expected a multiple of {DECISIONS_PER_SECOND}, got {show(self.fps)}")
        object.__setattr__(self, "fps", rate)  # 60.0 becomes 60
        object.__setattr__(self, "resets", check_resets(self.resets))

    @property
    def steps_per_frame(self) -> int:
        """Physics steps from one decision to the next."""
        return self.fps // DECISIONS_PER_SECOND

    @property
    def steps(self) -> int:
        """Physics steps of an episode that is not solved."""
        return FRAMES * self.steps_per_frame


PROTOCOLS: Final[Mapping[str, EpisodeProtocol]] = MappingProxyType(
    {
        # The official environments fill their space twice before they play.
        "official": EpisodeProtocol("official", fps=10, resets=2),
        # What people play at: 60 steps a second in a fresh space.
        "smooth": EpisodeProtocol("smooth", fps=60, resets=1),
    }
)


def protocol_named(name: object) -> EpisodeProtocol:
    """Return a protocol.

    Raises:
        ValueError: no protocol has this name; one line.
    """
    if isinstance(name, str) and name in PROTOCOLS:
        return PROTOCOLS[name]
    raise ValueError(f"protocol: expected one of {', '.join(PROTOCOLS)}, got {show(name)}")

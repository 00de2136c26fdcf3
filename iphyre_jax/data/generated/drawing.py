"""Drawing scenes of a kind: "elements", of the elements of the basic games, or "unions", of two basic games each.

A chunk is CHUNK scenes that are drawn together, for speed. So a scene is a function of its kind, the seed and its
number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, Literal, NamedTuple

import numpy as np

from iphyre_jax.data.generated import compositions
from iphyre_jax.data.generated.canvas import BARS, FREE, PIN, SPRING, Bools, Canvas, Ints
from iphyre_jax.data.generated.compositions import draw_compositions
from iphyre_jax.data.generated.unions import draw_unions

CHUNK: Final = 2048
STREAM: Final = 20_26  # beside the seed, so that scenes draw other numbers than anything else

SceneKind = Literal["elements", "unions"]
DEFAULT_KIND: Final[SceneKind] = "elements"


class Drawing(NamedTuple):
    """How scenes of a kind are drawn.

    Attributes:
        draw: of a count and random numbers, returns so many scenes, whether each is whole, and its basic game.
        seed: beside that of all scenes.
        idle_share: of the scenes that solve themselves, the share that is kept.
    """

    draw: Callable[[int, np.random.Generator], tuple[Canvas, Bools, Ints]]
    seed: tuple[int, ...] = ()
    idle_share: float = 0.0


KINDS: Final[Mapping[SceneKind, Drawing]] = MappingProxyType(
    {"elements": Drawing(draw_compositions), "unions": Drawing(draw_unions, (1,), 0.2)}
)


def draw_chunk(seed: int, chunk: int, kind: SceneKind) -> tuple[Canvas, Ints, Ints]:
    """Draw the scenes chunk x CHUNK to (chunk + 1) x CHUNK - 1 of a seed.

    Returns:
        The scenes; which of them are whole, as indices; and of all, the index of the basic game that it began with,
        -1 for none.
    """
    rng = np.random.default_rng([seed, STREAM, chunk, *KINDS[kind].seed])
    canvas, whole, basic = KINDS[kind].draw(CHUNK, rng)
    whole &= (canvas.eliminable.sum(axis=1) >= 2) & _is_known(canvas)
    canvas.mirror(np.flatnonzero(rng.random(CHUNK) < 0.5))
    return canvas, np.flatnonzero(whole), basic


def _is_known(scenes: Canvas) -> Bools:
    """Return whether scenes have the moving bars and balls of one of MOVERS, (B,): so topologies stay few."""
    known = set()
    for names, _ in compositions.MOVERS:
        loose, free = (sum(name in kinds for name in names) for kinds in (("loose", "table"), ("ball", "table")))
        known.add((loose, free, names.count("pendulum"), names.count("spring")))
    balls = scenes.used[:, BARS:]
    tied = [(balls & (scenes.link == link)).sum(axis=1) for link in (FREE, PIN, SPRING)]
    found = np.stack([scenes.moving[:, :BARS].sum(axis=1), *tied], axis=1).tolist()
    return np.array([tuple(counts) in known for counts in found], bool)

"""Outcomes of plans, always decided in float64: in float32 one plan in 200 ends at another step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.plans import official_clock
from iphyre_jax.scenes import Scene
from iphyre_jax.simulation import simulate_many

DTYPE: Final = "float64"
FRESH: Final = 1  # resets: every play in a space of its own
MOST_PLANS: Final = 50_000  # in one call of the simulator


@dataclass(frozen=True, eq=False)
class Outcomes:
    """How B plays ended."""

    success: npt.NDArray[np.bool_]
    end_step: npt.NDArray[np.int16]
    removals: npt.NDArray[np.int8]
    fault: npt.NDArray[np.int8]  # 0 for a sound world


def frames(fps: int) -> int:
    """Return the steps of a whole play by the official clock: 900 at 60 steps a second, 151 at 10."""
    return len(official_clock(fps))


def label_plans(
    scenes: Sequence[Scene], game: npt.NDArray[np.integer], steps: npt.NDArray[np.integer], fps: int
) -> Outcomes:
    """Play B plans, each in a fresh space, on all cores.

    Args:
        scenes: what is played.
        game: (B,) index of each plan's scene.
        steps: (B, S) the step before which each block goes, -1 for never.
        fps: physics steps a second.
    """
    parts = [slice(first, first + MOST_PLANS) for first in range(0, len(game), MOST_PLANS)]
    seconds = frames(fps) / fps
    played = [
        simulate_many(scenes, game[part], steps[part], fps=fps, duration=seconds, dtype=DTYPE, resets=FRESH)
        for part in parts
    ]
    return Outcomes(
        np.concatenate([np.zeros(0, bool), *(result.success for result in played)]),
        np.concatenate([np.zeros(0, np.int16), *(result.steps for result in played)]).astype(np.int16),
        np.concatenate([np.zeros(0, np.int8), *(result.eliminations for result in played)]).astype(np.int8),
        np.concatenate([np.zeros(0, np.int8), *(result.fault for result in played)]).astype(np.int8),
    )

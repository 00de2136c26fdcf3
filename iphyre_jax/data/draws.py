"""Random plans, drawn one after the other: the same seed gives the same plans, whatever is played of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from iphyre_jax.compat.actions import draw_plans
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import Scene

INTERVAL: Final = 0.1  # s, times are multiples of it
OFFICIAL_SECONDS: Final = 7.0  # s, times of the official data sets are below it
STAYS: Final = 0.2  # probability that a block stays, beside that of the time 0
LAST_TIME: Final = {"official": OFFICIAL_SECONDS, "uniform15": TIME_LIMIT}

Plan = list[float]  # s for each slot; 0: the block stays


def random_plans(scene: Scene, distribution: str, seed: int) -> Iterator[Plan]:
    """Yield random plans of a scene without end; of a game with six blocks until there are hardly any others.

    A plan takes different instants of the 70 ("official") or 150 ("uniform15") below 7 s or 15 s; each becomes 0 with a
    probability of 0.2. All games with the same number of blocks see the same plans, as with the official function.
    """
    instants = list(np.arange(0, LAST_TIME[distribution], INTERVAL))
    return draw_plans(instants, len(scene.eliminable_blocks), scene.limits.blocks, seed, STAYS)

"""Random plans, drawn one after the other: the same seed gives the same plans, whatever is played of them.

A plan has a time in seconds for each slot; 0, as in the official data, or NaN: the block stays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from iphyre_jax.compat.actions import draw_plans
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import Scene

INTERVAL: Final = 0.1  # s, times are multiples of it
OFFICIAL_SECONDS: Final = 7.0  # s, times of the official data sets are below it
STAYS: Final = 0.2  # probability that a block stays, beside that of the time 0
LAST_TIME: Final = {"official": OFFICIAL_SECONDS, "uniform15": TIME_LIMIT}
FARTHEST: Final = 5  # tenths of a second between a plan and its neighbour, at most
NEIGHBOUR_STREAM: Final = 1  # beside the seed, so that neighbours draw other numbers than anything else

Plan = Sequence[float]


def random_plans(scene: Scene, distribution: str, seed: int) -> Iterator[Plan]:
    """Yield random plans of a scene without end; of a game with six blocks until there are hardly any others.

    A plan takes different instants of the 70 ("official") or 150 ("uniform15") below 7 s or 15 s; each becomes 0 with a
    probability of 0.2. All games with the same number of blocks see the same plans, as with the official function.
    """
    instants = list(np.arange(0, LAST_TIME[distribution], INTERVAL))
    return draw_plans(instants, len(scene.eliminable_blocks), scene.limits.blocks, seed, STAYS)


def neighbours(plans: Sequence[Plan], seed: int) -> Iterator[Plan]:
    """Yield neighbours of plans without end: one removal of one of them is moved by 0.1 to 0.5 s, within 7 s.

    Plans without a removal have no neighbour; if all are such, nothing is yielded.
    """
    tenths = [np.rint(np.nan_to_num(np.asarray(plan)) / INTERVAL).astype(int) for plan in plans]
    tenths = [plan for plan in tenths if plan.any()]
    rng = np.random.default_rng([seed, NEIGHBOUR_STREAM])
    last = round(OFFICIAL_SECONDS / INTERVAL) - 1
    while tenths:
        plan = tenths[rng.integers(len(tenths))].copy()
        slot = rng.choice(np.flatnonzero(plan))
        moved = plan[slot] + rng.choice((-1, 1)) * rng.integers(1, FARTHEST + 1)
        if 1 <= moved <= last and moved not in plan:
            plan[slot] = moved
            yield list(plan * INTERVAL)

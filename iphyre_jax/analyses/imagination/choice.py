"""Which of the imagined plans a planner tries, one after the other, and what that brings."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.imagination.imagined import RealRewards
from iphyre_jax.attempts.planner import preferred

SOLVED: Final = 500.0  # points; a solved play has more, any other has less
TRUST: Final = 0.2  # weight that a scene keeps when it was wrong about an attempt
TRIES: Final = 5  # as people have them

Floats = npt.NDArray[np.float64]


def tried(imagined: Floats, real: Floats, learning: bool) -> Floats:
    """Return the rewards of a planner's attempts, points: TRIES of them, or all N.

    Args:
        imagined: (K, N) points of different plans, in each of the K scenes that the planner believes in.
        real: (N,) points.
        learning: it sees how an attempt ended, and trusts scenes less that had foretold another outcome. Else it
            gives all its plans at once.
    """
    weights = np.ones(len(imagined))
    left = np.ones(imagined.shape[1], bool)
    rewards = []
    for _ in range(min(TRIES, len(real))):
        order = preferred(imagined, weights)
        plan = order[left[order]][0]
        left[plan] = False
        rewards.append(real[plan])
        if learning:
            wrong = (imagined[:, plan] > SOLVED) != (real[plan] > SOLVED)
            weights *= np.where(wrong, TRUST, 1.0)
    return np.array(rewards)


def best_after(imagined: Floats, real: RealRewards, plans: int, learning: bool = False) -> Floats:
    """Return the best reward after 1, ..., TRIES attempts in each draw, (draws, TRIES) points; no plan is tried twice.

    Args:
        imagined: (draws, K, PLANS) points.
        real: how the same plans end.
        plans: the first so many are imagined, without the repeated ones.
        learning: see `tried`.
    """
    found = []
    for own, ends, new in zip(imagined, real.reward, real.unrepeated, strict=False):
        which = np.flatnonzero(new[:plans])
        best = np.maximum.accumulate(tried(own[:, which], ends[which], learning))
        found.append(best[np.minimum(np.arange(TRIES), len(best) - 1)])
    return np.array(found)

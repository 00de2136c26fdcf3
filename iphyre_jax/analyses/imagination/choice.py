"""Which of the imagined plans a planner tries, one after the other, and what that brings."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.planner import preferred

SOLVED: Final = 500.0  # points; a solved play has more, any other has less
TRUST: Final = 0.2  # weight that a scene keeps when it was wrong about an attempt
TRIES: Final = 5  # as people have them

Floats = npt.NDArray[np.float64]


def tried(imagined: Floats, real: Floats, learning: bool) -> Floats:
    """Return the rewards of a planner's attempts, (TRIES,) points.

    Args:
        imagined: (K, N) points, in each of the K scenes that the planner believes in.
        real: (N,) points; at least TRIES.
        learning: it sees how an attempt ended, and trusts scenes less that had foretold another outcome. Else it
            gives all its plans at once.
    """
    weights = np.ones(len(imagined))
    left = np.ones(imagined.shape[1], bool)
    rewards = []
    for _ in range(TRIES):
        order = preferred(imagined, weights)
        plan = order[left[order]][0]
        left[plan] = False
        rewards.append(real[plan])
        if learning:
            wrong = (imagined[:, plan] > SOLVED) != (real[plan] > SOLVED)
            weights *= np.where(wrong, TRUST, 1.0)
    return np.array(rewards)


def best_after(imagined: Floats, real: Floats, plans: int, learning: bool = False) -> Floats:
    """Return the best reward after 1, ..., TRIES attempts in each draw, (draws, TRIES) points.

    Args:
        imagined: (draws, K, PLANS) points.
        real: (draws, PLANS) points.
        plans: the first so many are imagined, at least TRIES.
        learning: see `tried`.
    """
    rewards = [tried(own[:, :plans], ends[:plans], learning) for own, ends in zip(imagined, real, strict=False)]
    return np.maximum.accumulate(np.array(rewards), axis=1)

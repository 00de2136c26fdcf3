"""Rows of the tables: many plans summed up in shares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from parity.compare import PlanComparison
from parity.tolerances import EXACT_ERROR, SHARE_LIMITS


@dataclass(frozen=True)
class Summary:
    """One row of a table: the plans of one game or of all games.

    Attributes:
        name: the game, or "all".
        plans: number of plans.
        solved: plans that the reference solves.
        max_error: px, the largest error in play.
        shares: share of the plans within each of `tolerances.SHARE_LIMITS`.
        identical: share of the plans with every pose equal bit for bit.
        share_solved: share within `tolerances.EXACT_ERROR` of the plans that the reference solves; None without any.
        same_flag: share of the plans with the same success flag.
        same_step: share of the plans with the same success step.
        same_flag_solved: `same_flag` of the plans that the reference solves; None without any.
        same_step_solved: `same_step` of the plans that the reference solves; None without any.
        same_bookkeeping: share of the plans with the same eliminations and the same objects present.
        faults: plans that ended in a fault.
    """

    name: str
    plans: int
    solved: int
    max_error: float
    shares: tuple[float, ...]
    identical: float
    share_solved: float | None
    same_flag: float
    same_step: float
    same_flag_solved: float | None
    same_step_solved: float | None
    same_bookkeeping: float
    faults: int

    def within(self, limit: float) -> float:
        """Share of the plans within `limit` px, one of `tolerances.SHARE_LIMITS`."""
        return self.shares[SHARE_LIMITS.index(limit)]


def summarise(name: str, comparisons: Sequence[PlanComparison]) -> Summary:
    """Pool the plans of one or more games, at least one plan in all, into one row."""
    error = np.concatenate([c.error for c in comparisons])
    flag = np.concatenate([c.same_flag for c in comparisons])
    step = np.concatenate([c.same_step for c in comparisons])
    solved = np.concatenate([c.reference_success for c in comparisons])
    books = np.concatenate([c.same_eliminations & c.same_presence for c in comparisons])
    return Summary(
        name=name,
        plans=len(error),
        solved=int(solved.sum()),
        max_error=float(error.max()),
        shares=tuple(float(np.mean(error <= limit)) for limit in SHARE_LIMITS),
        identical=float(np.concatenate([c.identical for c in comparisons]).mean()),
        share_solved=float(np.mean(error[solved] <= EXACT_ERROR)) if solved.any() else None,
        same_flag=float(flag.mean()),
        same_step=float(step.mean()),
        same_flag_solved=float(flag[solved].mean()) if solved.any() else None,
        same_step_solved=float(step[solved].mean()) if solved.any() else None,
        same_bookkeeping=float(books.mean()),
        faults=int(sum(np.count_nonzero(c.fault) for c in comparisons)),
    )

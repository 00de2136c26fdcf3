"""Whether a table of the comparison meets its targets."""

from collections.abc import Sequence

from parity.reports.summary import Summary
from parity.tolerances import TARGETS, TIGHT_ERROR


def missed_targets(fps: int, dtype: str, games: Sequence[Summary], overall: Summary) -> list[str]:
    """One sentence for each target that a table misses, of its rows, one a game, and of the row of all together.

    Raises:
        ValueError: there are no targets for this rate and type.
    """
    target = TARGETS.get((dtype, fps))
    if target is None:
        raise ValueError(f"fps: expected one of {sorted({rate for _, rate in TARGETS})} (with targets), got {fps!r}")
    missed = [
        shortfall("plans within", f"{target.error:g} px", overall.within(target.error), target.share),
        shortfall("plans within", f"{TIGHT_ERROR:g} px", overall.within(TIGHT_ERROR), target.tight),
        shortfall("plans", "equal bit for bit", overall.identical, target.identical),
        shortfall("plans with", "the same success flag", overall.same_flag, target.flag),
        shortfall("plans with", "the same success step", overall.same_step, target.step),
        shortfall("plans with", "the same removals and objects", overall.same_bookkeeping, target.step),
    ]
    for row in games:
        within = row.within(target.error)
        missed.append(shortfall(f"{row.name}: plans within", f"{target.error:g} px", within, target.game_share))
    if overall.faults:
        missed.append(f"plans that end in a fault: {overall.faults}, expected none")
    return [sentence for sentence in missed if sentence]


def shortfall(subject: str, what: str, share: float, needed: float) -> str:
    """The sentence about a missed target; empty if it is met."""
    return f"{subject} {what}: {100 * share:.2f} %, expected at least {100 * needed:.2f} %" if share < needed else ""

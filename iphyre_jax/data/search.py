"""Draw plans of many scenes and play them round by round, until each has enough of both kinds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.draws import Plan
from iphyre_jax.data.journal import Journal
from iphyre_jax.data.labels import FIRST_RESET, MOST_PLANS, Ints, Labels, PlayProtocol, label_plans
from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import Scene

FIRST_ROUND: Final = 2.6  # draws of a scene for each play wanted
STALE: Final = 1024  # draws in a row without a new play: there is hardly another
FEWEST: Final = 256  # draws of a scene that a round allows, however many scenes there are


@dataclass
class Search:
    """The draws of one scene so far."""

    plans: Iterator[Plan]
    wanted: tuple[int, int]  # plays that solve it, plays that do not
    most: int  # draws
    first: int = 0  # number of the first draw
    known: set[bytes] | None = None  # plays that are not kept, as `play_keys` gives them; None: repeats are kept
    times: list[Plan] = field(default_factory=list)
    labels: Labels = field(default_factory=lambda: Labels.join([]))
    keys: list[bytes] = field(default_factory=list)  # of the draws, as `play_keys` gives them
    is_new: list[bool] = field(default_factory=list)
    exhausted: bool = False

    def rows(self, solved: bool) -> npt.NDArray[np.intp]:
        """Return the draws of a kind that are kept: the first ones, as many as are wanted."""
        of_kind = (self.labels.success == solved) & (self.labels.fault == 0) & np.array(self.is_new, bool)
        return np.flatnonzero(of_kind)[: self.wanted[0 if solved else 1]]

    def waits(self) -> tuple[int, int]:
        """Return the draws until the last kept play of each kind."""
        solved, failed = self.rows(True), self.rows(False)
        return int(solved[-1]) + 1 if len(solved) else 0, int(failed[-1]) + 1 if len(failed) else 0

    def missing(self) -> tuple[int, int]:
        """Return how many plays of each kind are still wanted."""
        return self.wanted[0] - len(self.rows(True)), self.wanted[1] - len(self.rows(False))

    def draws(self) -> int:
        """Return the draws until the loop stops: when both kinds are complete, or with the last draw."""
        return len(self.times) if any(self.missing()) else max(self.waits())

    def next_draws(self, at_most: int) -> list[Plan]:
        """Draw as many plans as will probably do; none if there are enough of both kinds, or no more allowed."""
        missing, made = self.missing(), len(self.times)
        self.exhausted |= made >= STALE and not any(self.is_new[-STALE:])
        if not any(missing) or self.exhausted:
            return []
        rate = (int(self.labels.success.sum()) + 1) / (made + 4)
        likely = max(missing[0] / rate, missing[1] / (1 - rate)) if made else FIRST_ROUND * max(missing)
        count = min(int(1.1 * likely) + 8, 4 * made + FEWEST, at_most, self.most - made)
        drawn = list(islice(self.plans, count))
        self.exhausted = len(drawn) < count or made + len(drawn) >= self.most
        self.times += drawn
        return drawn

    def add(self, steps: Ints, labels: Labels) -> None:
        """Note how the draws of a round ended."""
        self.labels = Labels.join([self.labels, labels])
        for key in play_keys(steps, labels.end_step):
            self.keys.append(key)
            self.is_new.append(self.known is None or key not in self.known)
            if self.known is not None:
                self.known.add(key)

    def surplus(self) -> set[bytes]:
        """Return the plays that a last round drew beyond those wanted: another search may still keep them."""
        kept = {*self.rows(True).tolist(), *self.rows(False).tolist()}
        return {key for row, key in enumerate(self.keys) if self.is_new[row] and row not in kept}


def play_keys(steps: Ints, end_step: Ints) -> list[bytes]:
    """Name plays: two plays of a scene have the same name if the same blocks go at the same steps before their end."""
    executed = np.where(steps < end_step[:, None], steps, NEVER).astype(np.int16)
    return [row.tobytes() for row in executed]


def run_searches(
    scenes: Sequence[Scene], searches: Sequence[Search], protocol: PlayProtocol, exact: bool, journal: Journal
) -> None:
    """Draw and play, all scenes together, until each has enough of both kinds or no draws left.

    Args:
        scenes: one for each search; a scene may come several times.
        searches: what is wanted; they are filled.
        protocol: how plans become plays.
        exact: whether draw k is the play after the reset k + 2 of one space, as in the official loop.
        journal: keeps the plays.
    """
    active = len(searches)
    while any(drawn := [search.next_draws(max(FEWEST, MOST_PLANS // max(active, 1))) for search in searches]):
        counts = [len(plans) for plans in drawn]
        active = sum(count > 0 for count in counts)
        game = np.repeat(np.arange(len(scenes)), counts)
        times = np.array([plan for plans in drawn for plan in plans], np.float64)  # as they are kept
        steps = protocol.steps(times)
        firsts = [search.first + len(search.times) - count for search, count in zip(searches, counts, strict=True)]
        draws = np.concatenate([first + np.arange(count) for first, count in zip(firsts, counts, strict=True)])
        labels = label_plans(scenes, game, steps, protocol, draws + FIRST_RESET if exact else None, journal)
        for index in np.unique(game):
            own = game == index
            searches[index].add(steps[own], labels.take(own))
        journal.report(_progress(searches))


def _progress(searches: Sequence[Search]) -> str:
    wanted = sum(sum(search.wanted) for search in searches)
    kept = wanted - sum(sum(search.missing()) for search in searches)
    return f"{kept} of {wanted} plays from {sum(len(search.times) for search in searches)} draws"


def kept_rows(search: Search) -> dict[str, npt.NDArray[Any]]:
    """Return the kept plays of a search in the order of their draws, as columns."""
    rows = np.sort(np.concatenate([search.rows(True), search.rows(False)]))
    slots = len(search.times[0]) if search.times else 0
    return {
        "times": np.array(search.times, np.float64).reshape(len(search.times), slots)[rows],
        **search.labels.take(rows).columns(search.first + rows),
    }

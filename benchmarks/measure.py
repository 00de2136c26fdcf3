"""Engines in turns on one work, and what their turns say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.crew import GAME_FACTOR, Crew
from benchmarks.work import Work
from benchmarks.workers.protocol import Played

MOST_REPEATS = 50


@dataclass(frozen=True)
class Measurement:
    """One engine on one work.

    Attributes:
        engine: its name.
        work: a game, or "mixed".
        fps: physics steps a second.
        episodes: plans played.
        steps: steps really made in them.
        solved: share of the plans that solve their game.
        reward: mean reward.
        same_steps: share of the plans that end with the same step as in the first engine of the run, of those that both
            play.
        first_seconds: the first play of the work, with all that is compiled for it.
        seconds: of one play, for each turn.
    """

    engine: str
    work: str
    fps: int
    episodes: int
    steps: int
    solved: float
    reward: float
    same_steps: float
    first_seconds: float
    seconds: tuple[float, ...]

    @property
    def rates(self) -> list[float]:
        """Steps a second, for each turn."""
        return [self.steps / seconds for seconds in self.seconds]

    @property
    def rate(self) -> float:
        """Median of the steps a second."""
        return median(self.rates)

    @property
    def compile_seconds(self) -> float:
        """What the first play took longer than a later one."""
        return max(0.0, self.first_seconds - median(self.seconds))


def compare(crews: Sequence[Crew], work: Work, turns: int, least_seconds: float) -> list[Measurement]:
    """Let every crew play the work, in turns.

    Args:
        crews: the engines; the first is what the others' steps are compared with.
        work: each crew plays its first rows, as many rounds as its engine is good for.
        turns: how often each crew plays.
        least_seconds: a crew that is quicker plays several times a turn, so that a turn can be timed.
    """
    factor = GAME_FACTOR if len(work.games) == 1 else len(work.games)
    works = [work.first(crew.engine.rounds * factor) for crew in crews]
    loaded = [crew.load(part) for crew, part in zip(crews, works, strict=True)]
    # A turn's length is not known from the first play, which compiles: one more play tells.
    repeats = [max(1, min(MOST_REPEATS, math.ceil(least_seconds / crew.turn(1)))) for crew in crews]
    seconds: list[list[float]] = [[] for _ in crews]
    for _ in range(turns):
        for crew, times, found in zip(crews, repeats, seconds, strict=True):
            found.append(crew.turn(times) / times)
    reference = loaded[0][0]
    return [
        _measurement(crew.engine.name, part, played, first, reference, tuple(found))
        for crew, part, (played, first), found in zip(crews, works, loaded, seconds, strict=True)
    ]


def _measurement(
    engine: str, work: Work, played: Played, first: float, reference: Played, seconds: tuple[float, ...]
) -> Measurement:
    both = list(zip(played.steps, reference.steps, strict=False))
    return Measurement(
        engine=engine,
        work=work.name,
        fps=work.fps,
        episodes=len(played.steps),
        steps=sum(played.steps),
        solved=sum(played.success) / len(played.success),
        reward=sum(played.reward) / len(played.reward),
        same_steps=sum(a == b for a, b in both) / len(both),
        first_seconds=first,
        seconds=seconds,
    )


def ratio(one: Measurement, other: Measurement) -> float:
    """How many times as many steps a second, turn by turn, as a median."""
    return median(a / b for a, b in zip(one.rates, other.rates, strict=True))

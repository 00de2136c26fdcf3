"""Engines in turns on one work, and what their turns say."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.worker_pool import Crew, Turn
from benchmarks.workers.protocol import Played
from benchmarks.workload import Work

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
        processor_seconds: of all its processes, likewise.
        memory: bytes, the most that any of its processes has held so far.
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
    processor_seconds: tuple[float, ...]
    memory: int

    @property
    def rates(self) -> list[float]:
        """Steps a second, for each turn."""
        return [self.steps / seconds for seconds in self.seconds]

    @property
    def rate(self) -> float:
        """Median of the steps a second."""
        return median(self.rates)

    @property
    def step_cost(self) -> float:
        """Median of the processor seconds a step."""
        return median(self.processor_seconds) / self.steps

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
    works = [work.first(crew.engine.rounds_of(work) * len(work.games)) for crew in crews]
    loaded = [crew.load(part) for crew, part in zip(crews, works, strict=True)]
    # A turn's length is not known from the first play, which compiles: one more play tells. It is a turn itself if it
    # was long enough.
    trials = [crew.turn(1) for crew in crews]
    repeats = [max(1, min(MOST_REPEATS, math.ceil(least_seconds / trial.seconds))) for trial in trials]
    rounds = [trials] if max(repeats) == 1 else []
    while len(rounds) < turns:
        rounds.append([crew.turn(times) for crew, times in zip(crews, repeats, strict=True)])
    reference = loaded[0][0]
    return [
        _measurement(crew.engine.name, part, played, first, reference, found)
        for crew, part, (played, first), *found in zip(crews, works, loaded, *rounds, strict=True)
    ]


def _measurement(
    engine: str, work: Work, played: Played, first: float, reference: Played, turns: Sequence[Turn]
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
        seconds=tuple(turn.seconds for turn in turns),
        processor_seconds=tuple(turn.processor_seconds for turn in turns),
        memory=max(turn.memory for turn in turns),
    )


def ratio(one: Measurement, other: Measurement) -> float:
    """How many times as many steps a second, turn by turn, as a median."""
    return median(a / b for a, b in zip(one.rates, other.rates, strict=True))

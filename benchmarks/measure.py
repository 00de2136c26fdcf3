"""Measure engines in turns on one workload."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.worker_pool import Repeat, WorkerPool
from benchmarks.workers.protocol import EpisodeResults
from benchmarks.workload import Workload

MAX_PLAYS = 50


@dataclass(frozen=True)
class Measurement:
    """One engine on one workload.

    Attributes:
        engine: its name.
        workload: a game, or "mixed".
        fps: physics steps a second.
        episodes: plans played.
        steps: steps made in them.
        solved: share of the plans that solve their game.
        reward: mean reward.
        same_steps: of the plans that the run's first engine plays too, the share that ends with the same step.
        first_seconds: of the first play, compilation included.
        seconds: of one play, for each repeat.
        processor_seconds: of all processes in one play, for each repeat.
        memory: bytes, the most that any of its processes has held so far.
    """

    engine: str
    workload: str
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
        """Steps a second in each repeat."""
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
        """Seconds by which the first play exceeds the median of the later ones."""
        return max(0.0, self.first_seconds - median(self.seconds))


def compare(pools: Sequence[WorkerPool], workload: Workload, repeats: int, min_seconds: float) -> list[Measurement]:
    """Let the engines play a workload in turns.

    Args:
        pools: the engines' workers; the others' steps are compared with the first one's.
        workload: each engine plays its first rows, as many as suit its speed.
        repeats: how often each engine is measured.
        min_seconds: of a repeat; a quicker engine plays several times in each, so that it can be timed.
    """
    workloads = [workload.first(pool.engine.plans_per_game_in(workload) * len(workload.games)) for pool in pools]
    loaded = [pool.load(part) for pool, part in zip(pools, workloads, strict=True)]
    # The first play compiles, so one more is timed. It counts as a repeat if every engine took long enough for it.
    trials = [pool.repeat(1) for pool in pools]
    plays = [max(1, min(MAX_PLAYS, math.ceil(min_seconds / trial.seconds))) for trial in trials]
    measured = [trials] if max(plays) == 1 else []
    while len(measured) < repeats:
        measured.append([pool.repeat(times) for pool, times in zip(pools, plays, strict=True)])
    reference = loaded[0][0]
    return [
        _measurement(pool.engine.name, part, played, first, reference, own)
        for pool, part, (played, first), *own in zip(pools, workloads, loaded, *measured, strict=True)
    ]


def _measurement(
    engine: str,
    workload: Workload,
    played: EpisodeResults,
    first: float,
    reference: EpisodeResults,
    repeats: Sequence[Repeat],
) -> Measurement:
    both = list(zip(played.steps, reference.steps, strict=False))
    return Measurement(
        engine=engine,
        workload=workload.name,
        fps=workload.fps,
        episodes=len(played.steps),
        steps=sum(played.steps),
        solved=sum(played.success) / len(played.success),
        reward=sum(played.reward) / len(played.reward),
        same_steps=sum(a == b for a, b in both) / len(both),
        first_seconds=first,
        seconds=tuple(repeat.seconds for repeat in repeats),
        processor_seconds=tuple(repeat.processor_seconds for repeat in repeats),
        memory=max(repeat.memory for repeat in repeats),
    )


def ratio(one: Measurement, other: Measurement) -> float:
    """Median over the repeats of the ratio of two engines' steps a second."""
    return median(a / b for a, b in zip(one.rates, other.rates, strict=True))

"""Decisions on the fly, with observations, beside plain simulation of the same plans."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.worker_pool import ROOT
from benchmarks.workload import MIXED


@dataclass(frozen=True)
class Deciding:
    """Seconds of whole episodes in one process, in turns.

    Attributes:
        work: a game, or "mixed".
        fps: physics steps a second; a decision lasts 0.1 s.
        worlds: side by side.
        steps: physics steps really made, by name of what was measured.
        same_steps: share of the worlds that end with the same step both ways.
        seconds: for "simulate", "scan" (a user's scan over `env.step`, autoreset), "reads" (`unroll`, the policy reads
            its observations) and "keeps" (they are kept too): wall-clock and processor seconds of each turn.
        compiled: s, compilation of the program of "scan", the engine's own being there.
    """

    work: str
    fps: int
    worlds: int
    steps: dict[str, int]
    same_steps: float
    seconds: dict[str, list[tuple[float, float]]]
    compiled: float

    def rate(self, name: str, clock: int) -> float:
        """Return the median of the steps a second, by the wall clock (0) or the processor's (1)."""
        return median(self.steps[name] / turn[clock] for turn in self.seconds[name])

    def share(self, name: str, clock: int) -> float:
        """Return the median, over turns, of the throughput as a share of plain simulation's."""
        pairs = zip(self.seconds["simulate"], self.seconds[name], strict=True)
        more = self.steps[name] / self.steps["simulate"]
        return more * median(plain[clock] / turn[clock] for plain, turn in pairs)


def deciding(
    works: Sequence[Sequence[str]], fps: Sequence[int], turns: int, done: Callable[[list[Deciding]], None]
) -> None:
    """Measure each work, the games of one process, at each frame rate; `done` is called with what was found.

    Raises:
        RuntimeError: a process ends without a result; one line.
    """
    for games in works:
        worlds = 1024
        for rate in fps:
            around = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
            numbers = map(str, (rate, worlds, turns))
            command = [sys.executable, "-m", "benchmarks.workers.on_the_fly", *numbers, *games]
            ran = subprocess.run(command, env=around, text=True, stdout=subprocess.PIPE, check=False)  # noqa: S603
            if ran.returncode:
                raise RuntimeError(f"decisions in {', '.join(games)}: the process ended with {ran.returncode}")
            told = json.loads(ran.stdout.splitlines()[-1])
            done([Deciding(games[0] if len(games) == 1 else MIXED, rate, worlds, **told)])

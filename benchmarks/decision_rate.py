"""Speed of decisions on the fly, with observations, beside plain simulation of the same plans."""

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

WORLDS = 1024


@dataclass(frozen=True)
class DecisionRate:
    """Seconds of whole episodes, measured in turns in one process.

    Attributes:
        workload: a game, or "mixed".
        fps: physics steps a second; a decision lasts 0.1 s.
        worlds: in the batch.
        steps: physics steps made, by variant.
        same_steps: share of the worlds that end with the same step on the fly and in plain simulation.
        seconds: wall-clock and processor seconds of each repeat by variant: "simulate"; "scan" (a user's scan over
            `env.step` with autoreset); "xla" and "spread" (the same with `backend="xla"`, on one CPU device and on
            several, as many as there are cores); "reads" (`unroll` with a policy that reads its observations); "keeps"
            (the observations are returned too).
        compiled: s to compile the program of "scan", "xla" and "spread" when the engine's own programs exist.
    """

    workload: str
    fps: int
    worlds: int
    steps: dict[str, int]
    same_steps: float
    seconds: dict[str, list[tuple[float, float]]]
    compiled: dict[str, float]

    def rate(self, name: str) -> float:
        """Median of the steps a second of a variant, by the wall clock."""
        return median(self.steps[name] / wall for wall, _ in self.seconds[name])

    def share(self, name: str) -> float:
        """Median over the repeats of a variant's speed as a share of plain simulation's, by the wall clock."""
        pairs = zip(self.seconds["simulate"], self.seconds[name], strict=True)
        more = self.steps[name] / self.steps["simulate"]
        return more * median(plain[0] / repeat[0] for plain, repeat in pairs)


def measure_decisions(
    workloads: Sequence[Sequence[str]], fps: Sequence[int], repeats: int, done: Callable[[list[DecisionRate]], None]
) -> None:
    """Measure each workload (the games of one process) at each frame rate; call `done` with each result.

    Raises:
        RuntimeError: a process ends without a result; one line.
    """
    for games in workloads:
        for rate in fps:
            env = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
            numbers = map(str, (rate, WORLDS, repeats))
            command = [sys.executable, "-m", "benchmarks.workers.on_the_fly", *numbers, *games]
            ran = subprocess.run(command, env=env, text=True, stdout=subprocess.PIPE, check=False)  # noqa: S603
            if ran.returncode:
                raise RuntimeError(f"decisions in {', '.join(games)}: the process ended with {ran.returncode}")
            measured = json.loads(ran.stdout.splitlines()[-1])
            done([DecisionRate(games[0] if len(games) == 1 else MIXED, rate, WORLDS, **measured)])

"""The worker processes of one engine."""

from __future__ import annotations

import json
import math
import os
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from benchmarks.workers.protocol import EpisodeResults
from benchmarks.workload import Workload
from iphyre_jax.execution.compilation.cache_folder import CACHE_VARIABLE

ROOT = Path(__file__).parent.parent

GAME_FACTOR = 4  # one game gets more plans, or a repeat would be too short to be timed
STEPS = 150  # of an episode at 10 fps


@dataclass(frozen=True)
class Engine:
    """An engine, and how its workers are started.

    Attributes:
        name: its name in the tables.
        command: interpreter and module of a worker.
        processes: number of workers, which share a workload.
        plans_per_game: at 10 fps in a mixture; GAME_FACTOR times as many of a single game. Slow engines play few plans:
            the steps a second are the same.
        per_game: measured game by game too, not only on the mixture.
    """

    name: str
    command: tuple[str, ...]
    processes: int
    plans_per_game: int
    per_game: bool = True

    def plans_per_game_in(self, workload: Workload) -> int:
        """Plans a game of a workload: fewer if episodes have more steps, as many for each process."""
        factor = GAME_FACTOR if len(workload.games) == 1 else 1
        plans = max(1, self.plans_per_game * STEPS // max(STEPS, workload.steps))
        return factor * math.ceil(plans / self.processes) * self.processes


@dataclass(frozen=True)
class Repeat:
    """One measurement of one or more plays of a workload.

    Attributes:
        seconds: mean of a play.
        processor_seconds: mean of a play, all workers together.
        memory: bytes, the most that any worker has held since it started.
    """

    seconds: float
    processor_seconds: float
    memory: int


@dataclass(eq=False)
class WorkerPool:
    """An engine's workers, which hold one workload at a time; use it in a `with` statement."""

    engine: Engine
    versions: dict[str, str] = field(init=False)
    workers: list[subprocess.Popen[str]] = field(init=False, default_factory=list)

    def __enter__(self) -> WorkerPool:
        """Start the workers.

        Raises:
            RuntimeError: a worker ended before it answered; one line.
        """
        self._errors = tempfile.TemporaryFile("w+")  # a full pipe would block a worker
        env = {k: v for k, v in os.environ.items() if not k.startswith("IPHYRE_JAX_") or k == CACHE_VARIABLE}
        env |= {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu", "SDL_VIDEODRIVER": "dummy"}
        env |= {"PYGAME_HIDE_SUPPORT_PROMPT": "1", "PYTHONWARNINGS": "ignore"}
        for _ in range(self.engine.processes):
            worker = subprocess.Popen(  # noqa: S603 - our own words
                self.engine.command,
                env=env,
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
            )
            self.workers.append(worker)
        try:
            self.versions = [self._answer(worker) for worker in self.workers][-1]
        except RuntimeError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End the workers."""
        for worker in self.workers:
            worker.kill()
            worker.communicate()
        self._errors.close()

    def load(self, workload: Workload) -> tuple[EpisodeResults, float]:
        """Give the workers a workload and let them play it once.

        Returns:
            The results by row, and the seconds of the slowest worker, compilation included.
        """
        shares = [rows for rows in workload.shares(self.engine.processes) if len(rows)]
        self._busy = self.workers[: len(shares)]
        for worker, rows in zip(self._busy, shares, strict=True):
            self._send(worker, {"do": "load", "job": workload.job(rows)})
        answers = [self._answer(worker) for worker in self._busy]
        merged = {}
        for name, kind in (("steps", int), ("success", bool), ("reward", float)):
            values = np.zeros(len(workload.plans), kind)
            for rows, answer in zip(shares, answers, strict=True):
                values[rows] = answer[name]
            merged[name] = values.tolist()
        return EpisodeResults(**merged), max(answer["seconds"] for answer in answers)

    def repeat(self, plays: int) -> Repeat:
        """Play the workload so many times; a play lasts until the slowest worker ends."""
        seconds, answers = 0.0, []
        for _ in range(plays):
            self._all("ready")
            begin = time.perf_counter()
            answers += self._all("play")
            seconds += time.perf_counter() - begin
        processor = sum(answer["processor_seconds"] for answer in answers)
        return Repeat(seconds / plays, processor / plays, max(answer["memory"] for answer in answers))

    def _all(self, word: str) -> list[dict[str, Any]]:
        for worker in self._busy:
            self._send(worker, {"do": word})
        return [self._answer(worker) for worker in self._busy]

    def _send(self, worker: subprocess.Popen[str], message: dict[str, Any]) -> None:
        pipe = cast(IO[str], worker.stdin)
        try:
            pipe.write(json.dumps(message) + "\n")
            pipe.flush()
        except BrokenPipeError:
            raise self._ended() from None

    def _answer(self, worker: subprocess.Popen[str]) -> dict[str, Any]:
        line = cast(IO[str], worker.stdout).readline()
        if not line:
            raise self._ended()
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _ended(self) -> RuntimeError:
        """The error for a worker that is gone, with the last line that it wrote."""
        self._errors.seek(0)
        last = self._errors.read().strip().splitlines()[-1:] or ["no message"]
        return RuntimeError(f"{self.engine.name}: a worker ended: {last[0]}")

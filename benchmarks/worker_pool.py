"""The processes that play for one engine."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import numpy as np

from benchmarks.workers.protocol import Played
from benchmarks.workload import Work
from iphyre_jax.execution.compilation.cache_folder import CACHE_VARIABLE

ROOT = Path(__file__).parent.parent


GAME_FACTOR = 4  # a turn on one game should not be too short to be timed
STEPS = 150  # of an episode at 10 fps


@dataclass(frozen=True)
class Engine:
    """What is measured, and how its workers are started.

    Attributes:
        name: its name in the tables.
        command: interpreter and module of a worker.
        processes: number of workers; the work is shared among them.
        rounds: plans a game at most, at 10 fps; slow engines play the first few, which is as good a sample of steps a
            second. Of a single game it plays GAME_FACTOR times as many.
        per_game: also measured game by game, not only on the mixture.
    """

    name: str
    command: tuple[str, ...]
    processes: int
    rounds: int
    per_game: bool = True

    def rounds_of(self, work: Work) -> int:
        """Plans a game of a work; fewer where an episode has more steps, but one for each process."""
        factor = GAME_FACTOR if len(work.games) == 1 else 1
        return factor * max(self.processes, self.rounds * STEPS // max(STEPS, work.steps))


@dataclass(frozen=True)
class Turn:
    """One play of a work, as a mean of a turn's plays.

    Attributes:
        seconds: by the clock.
        processor_seconds: of all workers together.
        memory: bytes, the most that any worker has held since it started.
    """

    seconds: float
    processor_seconds: float
    memory: int


@dataclass(eq=False)
class Crew:
    """An engine's workers, which hold one work at a time; to be used in a `with`."""

    engine: Engine
    versions: dict[str, str] = field(init=False)
    workers: list[subprocess.Popen[str]] = field(init=False, default_factory=list)

    def __enter__(self) -> Crew:
        """Start the workers.

        Raises:
            RuntimeError: one of them ended before its first word; one line.
        """
        self._errors = tempfile.TemporaryFile("w+")  # a file, not a pipe, which would stop a talkative worker
        around = {k: v for k, v in os.environ.items() if not k.startswith("IPHYRE_JAX_") or k == CACHE_VARIABLE}
        around |= {"PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu", "SDL_VIDEODRIVER": "dummy"}
        around |= {"PYGAME_HIDE_SUPPORT_PROMPT": "1", "PYTHONWARNINGS": "ignore"}
        for _ in range(self.engine.processes):
            worker = subprocess.Popen(  # noqa: S603 - our own words
                self.engine.command,
                env=around,
                text=True,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
            )
            self.workers.append(worker)
        try:
            self.versions = [self._answer(worker) for worker in self.workers][-1]
        except RuntimeError:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the workers."""
        self._end()

    def _end(self) -> None:
        for worker in self.workers:
            worker.kill()
            worker.communicate()
        self._errors.close()

    def load(self, work: Work) -> tuple[Played, float]:
        """Give the workers a work and let them play it once.

        Returns:
            What came out, by row, and the seconds of the slowest worker, compilation included.
        """
        shares = [rows for rows in work.shares(self.engine.processes) if len(rows)]
        self._busy = self.workers[: len(shares)]
        for worker, rows in zip(self._busy, shares, strict=True):
            self._send(worker, {"do": "load", "job": work.job(rows)})
        answers = [self._answer(worker) for worker in self._busy]
        merged = {}
        for name, kind in (("steps", int), ("success", bool), ("reward", float)):
            values = np.zeros(len(work.plans), kind)
            for rows, answer in zip(shares, answers, strict=True):
                values[rows] = answer[name]
            merged[name] = values.tolist()
        return Played(**merged), max(answer["seconds"] for answer in answers)

    def turn(self, repeats: int) -> Turn:
        """Play the work so many times, each from the start to the slowest worker's end."""
        seconds, answers = 0.0, []
        for _ in range(repeats):
            self._all("ready")
            begin = time.perf_counter()
            answers += self._all("play")
            seconds += time.perf_counter() - begin
        processor = sum(answer["processor_seconds"] for answer in answers)
        return Turn(seconds / repeats, processor / repeats, max(answer["memory"] for answer in answers))

    def _all(self, word: str) -> list[dict[str, Any]]:
        for worker in self._busy:
            self._send(worker, {"do": word})
        return [self._answer(worker) for worker in self._busy]

    def _send(self, worker: subprocess.Popen[str], message: dict[str, Any]) -> None:
        pipe = cast(IO[str], worker.stdin)
        pipe.write(json.dumps(message) + "\n")
        pipe.flush()

    def _answer(self, worker: subprocess.Popen[str]) -> dict[str, Any]:
        line = cast(IO[str], worker.stdout).readline()
        if not line:
            self._errors.seek(0)
            last = self._errors.read().strip().splitlines()[-1:] or ["no message"]
            raise RuntimeError(f"{self.engine.name}: a worker ended: {last[0]}")
        found: dict[str, Any] = json.loads(line)
        return found

"""Time from the start of a process to its first result, with an empty and with a warm compilation cache."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import IO, cast

import iphyre_jax
from benchmarks.worker_pool import ROOT
from benchmarks.workload import MIXED


@dataclass(frozen=True)
class Startup:
    """Seconds from the start of a process to the result of its first batch.

    Attributes:
        workload: a game, or "mixed" for all forty.
        moving: largest number of moving bodies in any of the games.
        batch: worlds.
        empty: s with an empty cache, compilation and the trial of compiler options included.
        warm: s in a second process.
        processor: processor seconds of both, which tell more on a busy machine.
    """

    workload: str
    moving: int
    batch: int
    empty: float
    warm: float
    processor: tuple[float, float]


def one_game_per_size() -> list[str]:
    """The first game with each number of moving bodies."""
    sizes = {game: int(iphyre_jax.load_scene(game).dynamic.sum()) for game in iphyre_jax.GAMES}
    return [next(game for game in sizes if sizes[game] == size) for size in sorted(set(sizes.values()))]


def measure_startups(jobs: Sequence[Sequence[str]], batch: int, done: Callable[[list[Startup]], None]) -> None:
    """Measure each job (the names of its games) in two fresh processes; call `done` with each result."""
    for games in jobs:
        with tempfile.TemporaryDirectory() as folder:
            cache = os.path.join(folder, "cache")  # noqa: PTH118
            (empty, warm), processor = zip(*(_seconds(cache, batch, games) for _ in range(2)), strict=True)
        moving = max(int(iphyre_jax.load_scene(game).dynamic.sum()) for game in games)
        done([Startup(games[0] if len(games) == 1 else MIXED, moving, batch, empty, warm, processor)])


def _seconds(cache: str, batch: int, games: Sequence[str]) -> tuple[float, float]:
    """Run one process until it prints its result; return wall-clock and processor seconds."""
    env = {**os.environ, "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-m", "benchmarks.workers.time_to_first_result", cache, str(batch), *games]
    begin, used = time.perf_counter(), _used()
    with subprocess.Popen(command, env=env, text=True, stdout=subprocess.PIPE) as process:  # noqa: S603
        answer = cast(IO[str], process.stdout).readline()
        seconds = time.perf_counter() - begin
    if not answer:
        raise RuntimeError(f"no first result of {', '.join(games)}: the process ended with {process.returncode}")
    return seconds, _used() - used


def _used() -> float:
    """Processor seconds of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime

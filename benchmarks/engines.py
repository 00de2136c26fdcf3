"""The engines that are compared."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from benchmarks.venvs import python_of
from benchmarks.worker_pool import Engine

STEPPING = "pymunk, Space.step alone"
EPISODES = "pymunk, episodes"
FLOAT32 = "iphyre_jax float32"
FLOAT64 = "iphyre_jax float64"
OFFICIAL = "official class"
JAX2D = "Jax2D"
PARTS = ("official", "jax2d")  # engines that need an environment of their own


def ours(dtype: str, cores: int, rounds: int, *options: str) -> Engine:
    """This project, in one process; options: words of its worker."""
    command = sys.executable, "-m", "benchmarks.workers.ours", dtype, str(cores), *options
    return Engine(f"iphyre_jax {dtype}", command, 1, rounds)


def engines(cores: int, rounds: int, without: Sequence[str]) -> tuple[list[Engine], list[str]]:
    """Return the engines with their numbers of plans, and one line for each that cannot be had.

    Args:
        cores: processes or threads that each engine gets.
        rounds: plans a game of ours at 10 fps; the others get as many as keep a turn of theirs short.
        without: names in PARTS to leave out.
    """

    def share(part: int) -> int:
        return max(cores, rounds // part)

    def pymunk(name: str, mode: str) -> Engine:
        return Engine(name, (sys.executable, "-m", "benchmarks.workers.bare_pymunk", mode), cores, share(16))

    found = [pymunk(STEPPING, "stepping"), pymunk(EPISODES, "episodes")]
    found += [ours(dtype, cores, share(1)) for dtype in ("float32", "float64")]
    problems = []
    for part, name, module, rows, per_game in (
        ("official", OFFICIAL, "official", share(256), True),
        ("jax2d", JAX2D, "jax2d_player", share(128), False),  # each size of scene is compiled for half a minute
    ):
        if part in without:
            continue
        try:
            command = str(python_of(part)), "-m", f"benchmarks.workers.{module}"
            found.append(Engine(name, command, cores, rows, per_game))
        except RuntimeError as error:
            problems.append(f"{name} is not measured: {error}")
    return found, problems

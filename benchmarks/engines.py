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


def ours(dtype: str, cores: int, plans_per_game: int, *options: str) -> Engine:
    """This project in one process; `options` go to its worker."""
    command = sys.executable, "-m", "benchmarks.workers.ours", dtype, str(cores), *options
    return Engine(f"iphyre_jax {dtype}", command, 1, plans_per_game)


def engines(cores: int, plans_per_game: int, without: Sequence[str]) -> tuple[list[Engine], list[str]]:
    """Return the available engines, and one line for each that is missing.

    Args:
        cores: processes or threads of each engine.
        plans_per_game: of this project at 10 fps; the slower engines get fewer, so that a repeat stays short.
        without: engines to leave out that need an environment of their own: "official", "jax2d".
    """

    def share(part: int) -> int:
        return max(cores, plans_per_game // part)

    def pymunk(name: str, mode: str) -> Engine:
        return Engine(name, (sys.executable, "-m", "benchmarks.workers.bare_pymunk", mode), cores, share(16))

    available = [pymunk(STEPPING, "stepping"), pymunk(EPISODES, "episodes")]
    available += [ours(dtype, cores, share(1)) for dtype in ("float32", "float64")]
    problems = []
    for part, name, module, rows, per_game in (
        ("official", OFFICIAL, "official", share(256), True),
        ("jax2d", JAX2D, "jax2d_player", share(128), False),  # it compiles half a minute for each size of scene
    ):
        if part in without:
            continue
        try:
            command = str(python_of(part)), "-m", f"benchmarks.workers.{module}"
            available.append(Engine(name, command, cores, rows, per_game))
        except RuntimeError as error:
            problems.append(f"{name} is not measured: {error}")
    return available, problems

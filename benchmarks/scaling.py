"""What a step costs as scenes, episodes, batches and threads grow, and how many bytes a world carries."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import iphyre_jax
from benchmarks.measure import Measurement, compare
from benchmarks.worker_pool import WorkerPool
from benchmarks.workload import make_workload
from iphyre_jax import Scene
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.programs import episode_layout

FPS = 10
SECONDS = 15.0  # of an episode, if its length does not grow
BARS, BALLS = 6, 1  # if their number does not grow
OBJECTS = range(3, 13)
MOVING = range(1, 7)
STEPS = (50, 150, 500, 1500)
MIN_SECONDS = 0.2  # of a repeat


@dataclass(frozen=True)
class SizeScaling:
    """The cost of a step at one size.

    Attributes:
        what: "objects", "moving bodies" or "steps".
        size: how many.
        measured: the measurement.
    """

    what: str
    size: int
    measured: Measurement


@dataclass(frozen=True)
class BatchScaling:
    """The speed of a mixture of games in batches of one size.

    Attributes:
        batch: worlds.
        players: "1 thread", "2 threads", "2 devices".
        measured: the measurement.
    """

    batch: int
    players: str
    measured: Measurement


def shelf(bars: int, balls: int) -> Scene:
    """A row of static bars; a ball rests on each of the first ones, and the last bar is eliminable."""
    left = 40.0 + 90 * np.arange(bars)
    blocks = np.stack([left, np.full(bars, 300.0), left + 60, np.full(bars, 300.0)], -1).reshape(-1, 2, 2)
    at_rest = np.stack([left[:balls] + 30, np.full(balls, 270.0), np.full(balls, 20.0)], -1)
    index = np.arange(bars + balls)
    return Scene(f"shelf {bars} {balls}", blocks, at_rest, index == bars - 1, index >= bars)


def sizes() -> list[tuple[str, int, Scene, float]]:
    """What grows, its size, the scene and the seconds of an episode; only one thing grows at a time."""
    rows = [("objects", size, shelf(size - 1, BALLS), SECONDS) for size in OBJECTS]
    rows += [("moving bodies", size, shelf(BARS, size), SECONDS) for size in MOVING]
    return rows + [("steps", size, shelf(BARS, BALLS), size / FPS) for size in STEPS]


def measure_sizes(pool: WorkerPool, repeats: int, seed: int, done: Callable[[list[SizeScaling]], None]) -> None:
    """Measure every size of `sizes`; call `done` with each result."""
    for what, size, scene, seconds in sizes():
        workload = make_workload([scene], 4 * pool.engine.plans_per_game, FPS, seed, seconds)
        done([SizeScaling(what, size, one) for one in compare([pool], workload, repeats, MIN_SECONDS)])


def measure_batches(
    pools: dict[str, WorkerPool],
    games: Sequence[str],
    batches: Sequence[int],
    repeats: int,
    seed: int,
    done: Callable[[list[BatchScaling]], None],
) -> None:
    """Measure a mixture of games in batches of several sizes, the pools (by players) in turns.

    Call `done` with the results of each size.
    """
    whole = make_workload(games, -(-max(batches) // len(games)), FPS, seed)
    for batch in sorted(batches):  # upwards, because a worker reports the most memory that it has held so far
        measured = compare(list(pools.values()), whole.first(batch), repeats, MIN_SECONDS)
        done([BatchScaling(batch, players, one) for players, one in zip(pools, measured, strict=True)])


def carried_bytes(game: str, dtype: str) -> int:
    """Bytes that a world of a game carries from step to step: its state and its result so far."""
    topology, _ = cached_world(iphyre_jax.load_scene(game), 1, dtype)
    layout = episode_layout(topology, dtype)
    arrays = zip(layout.shapes, layout.dtypes, strict=True)
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind in arrays)

"""How the cost of a step grows with objects, moving bodies and steps, each alone, on scenes made for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.measure import Measurement, compare
from benchmarks.worker_pool import Crew
from benchmarks.workload import make_work
from iphyre_jax import Scene

FPS = 10
SECONDS = 15.0  # of an episode where its length is not what grows
PLAIN = (6, 1)  # bars and balls where neither grows
OBJECTS = range(3, 13)
MOVING = range(1, 7)
STEPS = (50, 150, 500, 1500)


@dataclass(frozen=True)
class Growth:
    """The cost at one size.

    Attributes:
        what: "objects", "moving bodies" or "steps".
        size: how many.
        measured: what came out.
    """

    what: str
    size: int
    measured: Measurement


def shelf(bars: int, balls: int) -> Scene:
    """A row of fixed bars of which the first ones bear a ball each; the last bar can go."""
    left = 40.0 + 90 * np.arange(bars)
    blocks = np.stack([left, np.full(bars, 300.0), left + 60, np.full(bars, 300.0)], -1).reshape(-1, 2, 2)
    at_rest = np.stack([left[:balls] + 30, np.full(balls, 270.0), np.full(balls, 20.0)], -1)
    index = np.arange(bars + balls)
    return Scene(f"shelf {bars} {balls}", blocks, at_rest, index == bars - 1, index >= bars)


def sizes() -> list[tuple[str, int, Scene, float]]:
    """What grows, its size, the scene and the seconds of an episode."""
    rows = [("objects", size, shelf(size - 1, 1), SECONDS) for size in OBJECTS]
    rows += [("moving bodies", size, shelf(PLAIN[0], size), SECONDS) for size in MOVING]
    return rows + [("steps", size, shelf(*PLAIN), size / FPS) for size in STEPS]


def growth(crew: Crew, turns: int, seed: int, done: Callable[[list[Growth]], None]) -> None:
    """Measure every size; `done` is called with what was found for each."""
    for what, size, scene, seconds in sizes():
        work = make_work([scene], 4 * crew.engine.rounds, FPS, seed, seconds)
        done([Growth(what, size, one) for one in compare([crew], work, turns, least_seconds=0.2)])

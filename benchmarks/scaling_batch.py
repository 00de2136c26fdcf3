"""How speed goes with the batch and the number of threads, and what a world weighs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import iphyre_jax
from benchmarks.measure import Measurement, compare
from benchmarks.worker_pool import Crew
from benchmarks.workload import make_work
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.programs import episode_layout


@dataclass(frozen=True)
class Scale:
    """Steps a second of a mixture at one size.

    Attributes:
        batch: worlds.
        players: who plays them: "1 thread", "2 threads", "2 devices".
        measured: what came out.
    """

    batch: int
    players: str
    measured: Measurement


def scale(
    crews: dict[str, Crew],
    games: Sequence[str],
    batches: Sequence[int],
    turns: int,
    seed: int,
    done: Callable[[list[Scale]], None],
) -> None:
    """Measure the mixture of some games at several batch sizes, the crews in turns.

    Args:
        crews: players -> workers.
        games: names.
        batches: worlds.
        turns: how often each is measured.
        seed: of the plans.
        done: called with what was found for each batch.
    """
    whole = make_work(games, -(-max(batches) // len(games)), 10, seed)
    for batch in sorted(batches):  # a worker tells the most memory that it has held so far
        measured = compare(list(crews.values()), whole.first(batch), turns, least_seconds=0.2)
        done([Scale(batch, players, one) for players, one in zip(crews, measured, strict=True)])


def carried_bytes(game: str, dtype: str) -> int:
    """Bytes of what a world of a game carries from step to step: its state and its outcome so far."""
    topology, _ = cached_world(iphyre_jax.load_scene(game), 1, dtype)
    layout = episode_layout(topology, dtype)
    arrays = zip(layout.shapes, layout.dtypes, strict=True)
    return sum(math.prod(shape) * np.dtype(kind).itemsize for shape, kind in arrays)

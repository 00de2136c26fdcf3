"""How speed goes with the batch and the number of threads, and what a world weighs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import jax
import numpy as np

import iphyre_jax
from benchmarks.crew import Crew
from benchmarks.measure import Measurement, compare
from benchmarks.work import make_work
from iphyre_jax import programs, rollouts


@dataclass(frozen=True)
class Scale:
    """Steps a second of a mixture at one size.

    Attributes:
        batch: worlds.
        threads: threads that play them.
        measured: what came out.
    """

    batch: int
    threads: int
    measured: Measurement


def scale(
    crews: dict[int, Crew],
    games: Sequence[str],
    batches: Sequence[int],
    turns: int,
    seed: int,
    done: Callable[[], None],
) -> list[Scale]:
    """Measure the mixture of some games at several batch sizes, the numbers of threads in turns.

    Args:
        crews: number of threads -> workers.
        games: names.
        batches: worlds.
        turns: how often each is measured.
        seed: of the plans.
        done: called after each batch.
    """
    found = []
    whole = make_work(games, -(-max(batches) // len(games)), 10, seed)
    for batch in batches:
        measured = compare(list(crews.values()), whole.first(batch), turns, least_seconds=0.2)
        found += [Scale(batch, threads, one) for threads, one in zip(crews, measured, strict=True)]
        done()
    return found


def carried_bytes(game: str, dtype: str) -> int:
    """Bytes of what a world of a game carries from step to step: its state and its outcome so far."""
    with jax.enable_x64(dtype == "float64"):
        topology, world = programs.built(iphyre_jax.load_scene(game), 1, dtype)
        progress = jax.eval_shape(partial(rollouts.begin, topology), world, np.bool_(False))
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(progress))

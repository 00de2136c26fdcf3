"""``python -m benchmarks.workers.time_to_first_result CACHE BATCH GAME...``: play once, print a line and end."""

import sys

import numpy as np

import iphyre_jax
from benchmarks.workload import DURATION, make_workload


def main(cache: str, batch: int, games: list[str]) -> None:
    """Play a batch over the games at 10 fps in float32; load programs from the cache or add them to it."""
    iphyre_jax.configure(cache=cache)
    workload = make_workload(games, -(-batch // len(games)), 10, seed=0).first(batch)
    which = np.arange(batch) % len(games)
    played = iphyre_jax.simulate_many(games, which, workload.plans, fps=10, duration=DURATION)
    print(int(played.steps.sum()), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])

"""Play random plans of all forty games: ``python -m benchmarks.workers.final_poses FPS PLANS DTYPE FILE``.

It plays on JAX's first device and writes outcomes, (plays, 4): success, steps, removals, fault, and last poses, (plays,
objects, 3). Row r plays game r % 40. So two devices can be compared.
"""

import sys
from pathlib import Path

import numpy as np

import iphyre_jax
from benchmarks.workload import make_workload

SEED = 7


def main(fps: int, plans: int, dtype: str, file: Path) -> None:
    """Play and write the file."""
    workload = make_workload(iphyre_jax.GAMES, plans, fps, SEED)
    which = np.arange(len(workload.plans)) % len(workload.games)
    played = iphyre_jax.simulate_many(
        workload.games, which, workload.plans, fps=fps, dtype=dtype, sample_every=workload.steps
    )
    if played.samples is None:
        raise RuntimeError("no samples")
    outcomes = np.stack([played.success, played.steps, played.eliminations, played.fault], -1)
    with file.open("wb") as out:
        np.savez(out, outcomes=outcomes.astype(np.int64), poses=played.samples[:, -1])


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], Path(sys.argv[4]))

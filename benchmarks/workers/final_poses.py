"""Play random plans of all forty games: ``python -m benchmarks.workers.final_poses FPS PLANS FILE``.

It plays on JAX's first device and writes outcomes and last poses in both number types, so that another device can be
compared.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import iphyre_jax
from benchmarks.workload import make_workload

DTYPES = ("float64", "float32")
SEED = 7


def play(fps: int, plans: int, dtype: str) -> dict[str, NDArray[Any]]:
    """Return outcomes, (plays, 4) int64, and last poses, (plays, objects, 3); row r plays game r % 40."""
    workload = make_workload(iphyre_jax.GAMES, plans, fps, SEED)
    which = np.arange(len(workload.plans)) % len(workload.games)
    played = iphyre_jax.simulate_many(
        workload.games, which, workload.plans, fps=fps, dtype=dtype, sample_every=workload.steps
    )
    if played.samples is None:
        raise RuntimeError("no samples")
    counts = (played.success, played.steps, played.eliminations, played.fault)
    return {f"{dtype} outcomes": np.stack(counts, -1).astype(np.int64), f"{dtype} poses": played.samples[:, -1]}


def main(fps: int, plans: int, file: Path) -> None:
    """Play in both number types and write the file."""
    arrays: dict[str, NDArray[Any]] = {}
    for dtype in DTYPES:
        arrays |= play(fps, plans, dtype)
    with file.open("wb") as out:
        np.savez(out, **arrays)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))

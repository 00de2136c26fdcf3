"""``python -m parity.golden`` writes short plays of every game in pymunk, for tests where pymunk is not installed.

Each game has one file, in NumPy's format without pickle. For each frame rate it holds the plans, how they end, and
the float64 poses of the moving objects at every few steps. The plans are those of `parity.plans` with seed 0; the
space is fresh.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import iphyre_jax
from iphyre_jax import Scene
from iphyre_jax.files import pack_npz, replace_bytes
from parity.compare import PlanComparison, compare_plans
from parity.engines.trajectory import Trajectory
from parity.plans import random_plans

FOLDER = Path(__file__).parents[1] / "tests" / "parity" / "golden"
PLANS = 3  # plan 0 removes nothing
SEED = 0
DURATION = 15.0  # s
EVERY = {60: 12, 10: 2}  # frame rate -> steps between samples


@dataclass(frozen=True, eq=False)
class Golden:
    """Plays of one game at one frame rate.

    Attributes:
        fps: physics steps a second.
        eliminate_at: (B, S) int32, the plans.
        plays: the reference's plays, sampled at every `EVERY[fps]`-th step.
    """

    fps: int
    eliminate_at: NDArray[np.int32]
    plays: list[Trajectory]


def record(scene: Scene) -> list[Golden]:
    """Play a game's plans in pymunk at every rate."""
    from parity.engines.reference import run  # the only part that needs pymunk

    recorded = []
    for fps, every in EVERY.items():
        plans = random_plans(scene, PLANS, fps, SEED)
        steps = round(DURATION * fps)
        plays = [run(scene, row, fps=fps, steps=steps, sample_every=every) for row in plans]
        recorded.append(Golden(fps, plans, plays))
    return recorded


def write(scene: Scene, recorded: list[Golden], folder: Path = FOLDER) -> Path:
    """Write a game's file; create the folder if it is missing.

    Returns:
        The file.
    """
    fields: dict[str, NDArray[np.generic]] = {}
    for golden in recorded:
        columns = {
            "eliminate_at": golden.eliminate_at,
            "success": np.array([play.success for play in golden.plays]),
            "steps": np.array([play.steps for play in golden.plays], np.int32),
            "eliminations": np.array([play.eliminations for play in golden.plays], np.int32),
            "poses": np.stack([play.samples[:, scene.dynamic] for play in golden.plays]),
        }
        fields |= {f"{name}_{golden.fps}": column for name, column in columns.items()}
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{scene.name}.npz"
    replace_bytes(path, pack_npz(fields))
    return path


def read(scene: Scene, folder: Path = FOLDER) -> list[Golden]:
    """Read a game's file.

    Raises:
        OSError: the file is missing or cannot be read.
    """
    recorded = []
    with np.load(folder / f"{scene.name}.npz", allow_pickle=False) as file:
        for fps, every in EVERY.items():
            plans, success, steps, eliminations, poses = (
                file[f"{name}_{fps}"] for name in ("eliminate_at", "success", "steps", "eliminations", "poses")
            )
            plays = [
                Trajectory(bool(solved), int(end), int(removed), _samples(scene, plan, int(end), every, moving))
                for plan, solved, end, removed, moving in zip(plans, success, steps, eliminations, poses, strict=True)
            ]
            recorded.append(Golden(fps, plans, plays))
    return recorded


def _samples(
    scene: Scene, plan: NDArray[np.int32], end: int, every: int, moving: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Poses of all objects, (K, N, 3): moving ones as given, others at the scene's positions until removed."""
    samples = np.zeros((len(moving), scene.n_objects, 3))
    samples[..., :2] = scene.centres
    samples[:, scene.dynamic] = moving
    for block, when in zip(scene.eliminable_blocks, plan.tolist(), strict=True):
        if 0 <= when < end:
            samples[when // every + 1 :, block] = np.nan
    return samples


def compare(scene: Scene, golden: Golden, dtype: str = "float64") -> PlanComparison:
    """Play golden plans in our engine and compare."""
    every = EVERY[golden.fps]
    options = {"fps": golden.fps, "duration": DURATION, "dtype": dtype, "sample_every": every}
    ours = iphyre_jax.simulate(scene, golden.eliminate_at, **options)  # type: ignore[arg-type]  # values of several types
    return compare_plans(golden.plays, ours, scene.dynamic, golden.fps, every)


def main() -> int:
    """Write all files."""
    total = 0
    for name in iphyre_jax.GAMES:
        scene = iphyre_jax.load_scene(name)
        total += write(scene, record(scene)).stat().st_size
    print(f"{len(iphyre_jax.GAMES)} files, {total / 1e6:.2f} MB, in {FOLDER}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

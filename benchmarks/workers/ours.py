"""This project in a worker: ``python -m benchmarks.workers.ours DTYPE THREADS``."""

import os
import sys
from importlib.metadata import version

import numpy as np

import iphyre_jax
from benchmarks.workers.protocol import Job, Played, serve
from iphyre_jax.scenes import scene_from_dict


class Ours:
    """`iphyre_jax.simulate_many`, a host function: stacking the worlds and fetching the results is in its time."""

    def __init__(self, dtype: str) -> None:
        self.dtype = dtype

    def versions(self) -> dict[str, str]:
        """JAX and what it was told."""
        found = {name: version(name) for name in ("iphyre-jax", "jax", "jaxlib", "numpy")}
        return {**found, "XLA_FLAGS": os.environ.get("XLA_FLAGS", "")}

    def load(self, job: Job) -> None:
        """Make the scenes."""
        self.fps, self.duration = job.fps, job.steps / job.fps
        self.scenes = [scene_from_dict(scene, "job") for scene in job.scenes]
        self.which, self.plans = np.array(job.which), np.array(job.plans)

    def ready(self) -> None:
        """Nothing to prepare."""

    def play(self) -> None:
        """Play them all in one call."""
        self.played = iphyre_jax.simulate_many(
            self.scenes, self.which, self.plans, fps=self.fps, duration=self.duration, dtype=self.dtype
        )

    def outcome(self) -> Played:
        """The simulation's result as lists."""
        played = self.played
        return Played(played.steps.tolist(), played.success.tolist(), played.reward.tolist())


if __name__ == "__main__":
    # No cache: the first play of a job shows what compilation costs.
    iphyre_jax.configure(devices=int(sys.argv[2]), cache=False)
    serve(Ours(sys.argv[1]))

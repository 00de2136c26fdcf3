"""This project in a worker: ``python -m benchmarks.workers.ours DTYPE CORES [OPTION...]``.

Options: "devices" plays on a mesh of so many devices instead of so many "threads"; "cache" keeps compiled programs in
the user's folder, where nobody asks what compilation costs.
"""

import os
import sys
from importlib.metadata import version

import jax
import numpy as np

import iphyre_jax
from benchmarks.workers.protocol import Job, Played, serve
from iphyre_jax.scenes import scene_from_dict


class Ours:
    """`iphyre_jax.simulate_many`, a host function: stacking the worlds and fetching the results is in its time."""

    def __init__(self, dtype: str, mesh: jax.sharding.Mesh | None = None) -> None:
        self.dtype, self.mesh = dtype, mesh

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
            self.scenes,
            self.which,
            self.plans,
            fps=self.fps,
            duration=self.duration,
            dtype=self.dtype,
            mesh=self.mesh,
        )

    def outcome(self) -> Played:
        """The simulation's result as lists."""
        played = self.played
        return Played(played.steps.tolist(), played.success.tolist(), played.reward.tolist())


def main(dtype: str, cores: int, *options: str) -> None:
    """Serve. Without a cache the first play of a job shows what compilation costs."""
    iphyre_jax.configure(devices=cores, cache=None if "cache" in options else False)
    serve(Ours(dtype, jax.make_mesh((cores,), ("worlds",)) if "devices" in options else None))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *sys.argv[3:])

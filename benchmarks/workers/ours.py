"""This project in a worker: ``python -m benchmarks.workers.ours DTYPE CORES [OPTION...]``.

Options: "devices" plays on a mesh of CORES devices, "threads" (the default) on as many threads. "cache" keeps compiled
programs in the user's folder, for measurements that do not ask what compilation costs.
"""

import os
import sys
from importlib.metadata import version

import jax
import numpy as np

import iphyre_jax
from benchmarks.workers.protocol import EpisodeResults, Job, Player, serve
from iphyre_jax.scenes import scene_from_dict


class Ours(Player):
    """`iphyre_jax.simulate_many`; its time includes stacking the worlds and fetching the results."""

    def __init__(self, dtype: str, mesh: jax.sharding.Mesh | None = None) -> None:
        self.dtype, self.mesh = dtype, mesh

    def versions(self) -> dict[str, str]:
        """Versions of this project, JAX and NumPy, and XLA_FLAGS."""
        packages = {name: version(name) for name in ("iphyre-jax", "jax", "jaxlib", "numpy")}
        return {**packages, "XLA_FLAGS": os.environ.get("XLA_FLAGS", "")}

    def load(self, job: Job) -> None:
        """Build the scenes."""
        self.fps, self.duration = job.fps, job.steps / job.fps
        self.scenes = [scene_from_dict(scene, "job") for scene in job.scenes]
        self.which, self.plans = np.array(job.which), np.array(job.plans)

    def play(self) -> None:
        """Play them all in one call."""
        self.played = iphyre_jax.simulate_many(
            self.scenes, self.which, self.plans, fps=self.fps, duration=self.duration, dtype=self.dtype, mesh=self.mesh
        )

    def results(self) -> EpisodeResults:
        """The results as lists."""
        played = self.played
        return EpisodeResults(played.steps.tolist(), played.success.tolist(), played.reward.tolist())


def main(dtype: str, cores: int, *options: str) -> None:
    """Serve. Without a cache the first play of a job includes compilation."""
    iphyre_jax.configure(devices=cores, cache=None if "cache" in options else False)
    serve(Ours(dtype, jax.make_mesh((cores,), ("worlds",)) if "devices" in options else None))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), *sys.argv[3:])

"""pymunk in a worker: ``python -m benchmarks.workers.bare_pymunk MODE``.

MODE "stepping" shows the engine at its best: spaces are built before the clock starts, and the first play tells the
length of each episode. So the loop holds nothing but removals and `Space.step`; success and reward are found at the
end. MODE "episodes" builds each space and checks for success after each step, as anyone who plays plans must.
"""

import sys
from importlib.metadata import version

import numpy as np

from benchmarks.workers.protocol import EpisodeResults, Job, Player, serve, with_rewards
from iphyre_jax.scenes import scene_from_dict
from parity.engines.reference import ReferenceWorld, schedule

MODES = ("stepping", "episodes")


class BarePymunk(Player):
    """pymunk's `Space.step` in one space after the other."""

    def __init__(self, mode: str) -> None:
        if mode not in MODES:
            raise ValueError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
        self.mode = mode

    def versions(self) -> dict[str, str]:
        """Version of pymunk."""
        return {"pymunk": version("pymunk")}

    def load(self, job: Job) -> None:
        """Build the scenes and forget the lengths of the last job's episodes."""
        self.job = job
        scenes = [scene_from_dict(scene, "job") for scene in job.scenes]
        self.scenes = [scenes[k] for k in job.which]
        self.due = [
            schedule(scene, np.array(plan[: len(scene.eliminable_blocks)]))
            for scene, plan in zip(self.scenes, job.plans, strict=True)
        ]
        self.lengths: list[int] = []

    def ready(self) -> None:
        """Build the spaces of the mode "stepping"."""
        if self.lengths and self.mode == "stepping":
            self.worlds = [ReferenceWorld(scene) for scene in self.scenes]

    def play(self) -> None:
        """Play all plans; the first play checks for success after each step in both modes."""
        dt = 1.0 / self.job.fps
        if self.lengths and self.mode == "stepping":
            episodes = zip(self.worlds, self.due, self.lengths, strict=True)
            self.success = [_step_through(*episode, dt) for episode in episodes]
            return
        played = [
            _episode(ReferenceWorld(scene), due, self.job.steps, dt)
            for scene, due in zip(self.scenes, self.due, strict=True)
        ]
        self.lengths, self.success = [length for length, _ in played], [success for _, success in played]

    def results(self) -> EpisodeResults:
        """Lengths, success, and the rewards computed from them."""
        return with_rewards(self.job, self.lengths, self.success)


def _step_through(world: ReferenceWorld, due: dict[int, list[int]], length: int, dt: float) -> bool:
    """Make a known number of steps and return whether the game is solved."""
    step, count = world.space.step, 0
    for at in sorted(at for at in due if at < length):
        for _ in range(count, at):
            step(dt)
        for index in due[at]:
            world.eliminate(index)
        count = at
    for _ in range(count, length):
        step(dt)
    return world.solved()


def _episode(world: ReferenceWorld, due: dict[int, list[int]], limit: int, dt: float) -> tuple[int, bool]:
    """Step until the game is solved or the limit is reached; return the number of steps and the success."""
    step, solved = world.space.step, world.solved
    for count in range(limit):
        for index in due.get(count, ()):
            world.eliminate(index)
        step(dt)
        if solved():
            return count + 1, True
    return limit, False


if __name__ == "__main__":
    serve(BarePymunk(sys.argv[1]))

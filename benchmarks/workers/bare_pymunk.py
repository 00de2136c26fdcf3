"""pymunk in a worker: ``python -m benchmarks.workers.bare_pymunk MODE``.

MODE "stepping" is the most that can be said for the engine: spaces are built beforehand and the length of each episode
is known from the first play, so that nothing but removals and `Space.step` runs in the loop; success and reward follow
at the end. MODE "episodes" builds each space and looks for success after each step, as who plays plans has to.
"""

import sys
from importlib.metadata import version

import numpy as np

from benchmarks.workers.protocol import Job, Played, removed_before, reward, serve
from iphyre_jax.scenes import scene_from_dict
from parity.engines.reference import ReferenceWorld, schedule

MODES = ("stepping", "episodes")


class BarePymunk:
    """pymunk's `Space.step`, one space after the other."""

    def __init__(self, mode: str) -> None:
        if mode not in MODES:
            raise ValueError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
        self.mode = mode

    def versions(self) -> dict[str, str]:
        """The package that is measured."""
        return {"pymunk": version("pymunk")}

    def load(self, job: Job) -> None:
        """Make the scenes and forget the lengths of another job's episodes."""
        self.job = job
        scenes = [scene_from_dict(scene, "job") for scene in job.scenes]
        self.scenes = [scenes[k] for k in job.which]
        self.due = [
            schedule(scene, np.array(plan[: len(scene.eliminable_blocks)]))
            for scene, plan in zip(self.scenes, job.plans, strict=True)
        ]
        self.lengths: list[int] = []

    def ready(self) -> None:
        """Build the spaces."""
        if self.lengths and self.mode == "stepping":
            self.worlds = [ReferenceWorld(scene) for scene in self.scenes]

    def play(self) -> None:
        """Play all plans; the first time with a look at the balls after each step, in either mode."""
        if self.lengths and self.mode == "stepping":
            ways = zip(self.worlds, self.due, self.lengths, self._dt(), strict=True)
            self.success = [_step_through(*way) for way in ways]
            return
        played = [
            _episode(ReferenceWorld(scene), due, self.job.steps, dt)
            for scene, due, dt in zip(self.scenes, self.due, self._dt(), strict=True)
        ]
        self.lengths, self.success = [length for length, _ in played], [success for _, success in played]

    def _dt(self) -> list[float]:
        return [1.0 / self.job.fps] * len(self.scenes)

    def outcome(self) -> Played:
        """Lengths and success as found, and the rewards that follow from them."""
        rewards = [
            reward(success, removed_before(plan, length), length, self.job.fps)
            for success, length, plan in zip(self.success, self.lengths, self.job.plans, strict=True)
        ]
        return Played(self.lengths, self.success, rewards)


def _step_through(world: ReferenceWorld, due: dict[int, list[int]], length: int, dt: float) -> bool:
    """Make a known number of steps and return whether the game is solved."""
    step, made = world.space.step, 0
    for at in sorted(at for at in due if at < length):
        for _ in range(made, at):
            step(dt)
        for index in due[at]:
            world.eliminate(index)
        made = at
    for _ in range(made, length):
        step(dt)
    return world.solved()


def _episode(world: ReferenceWorld, due: dict[int, list[int]], limit: int, dt: float) -> tuple[int, bool]:
    """Step until the game is solved or the limit is reached; return the steps made and the success."""
    step, solved = world.space.step, world.solved
    for made in range(limit):
        for index in due.get(made, ()):
            world.eliminate(index)
        step(dt)
        if solved():
            return made + 1, True
    return limit, False


if __name__ == "__main__":
    serve(BarePymunk(sys.argv[1]))

"""The official class in a worker of its own environment: ``python -m benchmarks.workers.official``.

It calls `IPHYRE.step` once a step, as the official learning environments do: that steps, rewards, checks for success
and returns the observation. A click removes one block. If a plan removes several blocks before one step, `eliminate`
removes all but the last first.
"""

from importlib.metadata import version

from iphyre.simulator import IPHYRE

from benchmarks.workers.protocol import EpisodeResults, Job, Player, serve

NOTHING = [0.0, 0.0]  # the click that removes no block
REMOVAL = -10.0


class Official(Player):
    """The official class, a new one for each episode, because a used space orders contacts differently."""

    def versions(self) -> dict[str, str]:
        """Versions of iphyre, pymunk and NumPy."""
        return {name: version(name) for name in ("iphyre", "pymunk", "numpy")}

    def load(self, job: Job) -> None:
        """Find the clicks of each game."""
        self.job = job
        names = [scene["name"] for scene in job.scenes]
        clicks = [IPHYRE(name, fps=job.fps).get_action_space()[1:] for name in names]
        self.episodes = []
        for k, plan in zip(job.which, job.plans, strict=True):
            due: dict[int, list[list[float]]] = {}
            for column, at in enumerate(plan):
                if at >= 0:
                    due.setdefault(at, []).append(clicks[k][column])
            self.episodes.append((names[k], due))

    def play(self) -> None:
        """Play all plans."""
        self.played = [self._episode(name, due) for name, due in self.episodes]

    def _episode(self, name: str, due: dict[int, list[list[float]]]) -> tuple[int, bool, float]:
        game = IPHYRE(name, fps=self.job.fps)
        game.reset()
        total, steps, done = 0.0, 0, False
        while steps < self.job.steps and not done:
            *others, click = due.get(steps) or [NOTHING]
            for other in others:
                game.eliminate(other)
                total += REMOVAL
            _, gain, done = game.step(click)
            total += gain
            steps += 1
        return steps, bool(done), total

    def results(self) -> EpisodeResults:
        """Steps, success and the sums of the class's own rewards."""
        steps, success, reward = zip(*self.played, strict=True)
        return EpisodeResults(list(steps), list(success), list(reward))


if __name__ == "__main__":
    serve(Official())

"""The workload of every engine: random plans of one game or of a mixture, from one recorded seed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import iphyre_jax
from benchmarks.workers.protocol import Job
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene, SceneLike, scene_to_dict
from parity.plans import random_plans

DURATION = 15.0  # s: 150 steps at 10 fps, 900 at 60
MIXED = "mixed"


@dataclass(frozen=True, eq=False)
class Workload:
    """Episodes to play.

    Row r is plan r // G of game r % G. So the first rows are a mixture too, and a slow engine plays the first plans of
    a fast one.

    Attributes:
        name: a game, or "mixed".
        games: the G games.
        fps: physics steps a second.
        plans: (B, 6) step before which each eliminable block goes, -1 for never.
        duration: s of an episode.
    """

    name: str
    games: tuple[Scene, ...]
    fps: int
    plans: NDArray[np.int32]
    duration: float = DURATION

    @property
    def steps(self) -> int:
        """The most steps of an episode."""
        return round(self.duration * self.fps)

    def first(self, rows: int) -> Workload:
        """The same workload with only its first rows."""
        return replace(self, plans=self.plans[:rows])

    def shares(self, parts: int) -> list[NDArray[np.intp]]:
        """Rows for each of several processes, which all get the same mixture of games.

        The first plans are spread over the processes: they remove nothing, so they take longest, and a measurement ends
        with the slowest process.
        """
        plan, game = np.divmod(np.arange(len(self.plans)), len(self.games))
        owner = (plan + game) % parts
        return [np.flatnonzero(owner == part) for part in range(parts)]

    def job(self, rows: NDArray[np.intp]) -> dict[str, Any]:
        """Some rows as the `Job` of a worker, in JSON."""
        scenes = [scene_to_dict(game) for game in self.games]
        which = rows % len(self.games)
        return asdict(Job(scenes, which.tolist(), self.plans[rows].tolist(), self.fps, self.steps))


def make_workload(
    games: Sequence[SceneLike], plans_per_game: int, fps: int, seed: int, duration: float = DURATION
) -> Workload:
    """Draw plans as the parity comparison does.

    Args:
        games: one name or Scene, or several for a mixture.
        plans_per_game: the first of each game removes nothing.
        fps: physics steps a second.
        seed: of the plans.
        duration: s of an episode.
    """
    scenes = tuple(iphyre_jax.load_scene(game) for game in games)
    plans = np.full((plans_per_game, len(scenes), MAX_ELIMINABLE), -1, np.int32)
    for k, scene in enumerate(scenes):
        drawn = random_plans(scene, plans_per_game, fps, seed)
        plans[:, k, : drawn.shape[1]] = drawn
    name = scenes[0].name if len(scenes) == 1 else MIXED
    return Workload(name, scenes, fps, plans.reshape(-1, MAX_ELIMINABLE), duration)

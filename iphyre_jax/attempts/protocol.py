"""`attempts`: an agent tries each game k times and may, if asked, see how its earlier attempts ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED, as_floats, check_dtype, check_option, check_resets, check_whole, show, whole_fps
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND
from iphyre_jax.scenes import GAMES, Scene, SceneLike, load_scenes
from iphyre_jax.simulation import simulate_many

Feedback = Literal["outcome", "trajectory"]
FEEDBACK: Final = ("outcome", "trajectory")
MOST_ATTEMPTS: Final = 10_000

Floats = npt.NDArray[np.float64]


class Attempt(NamedTuple):
    """How one attempt ended, as its agent sees it."""

    times: Floats  # (S,) s, the plan; NaN for never
    success: bool
    reward: float
    eliminations: int
    seconds: float  # played
    poses: npt.NDArray[np.floating[Any]] | None  # with "trajectory": (T, N, 3) px, px, rad, every 0.1 s


Agent = Callable[[Scene, int, np.random.Generator, Sequence[Attempt]], npt.ArrayLike]
"""Proposes plans: (scene, count, generator, past attempts) -> (count, S) s of the eliminable blocks, NaN for never."""


@dataclass(frozen=True, eq=False)
class Attempts:
    """Results of G games, R runs and k attempts.

    Attributes:
        games: names of the games.
        success: (G, R, k) bool.
        reward: (G, R, k) float64, points.
        eliminations: (G, R, k) int64.
        seconds: (G, R, k) float64, s played.
        faults: attempts whose physics failed; they count as not solved.
    """

    games: tuple[str, ...]
    success: npt.NDArray[np.bool_]
    reward: Floats
    eliminations: npt.NDArray[np.integer[Any]]
    seconds: Floats
    faults: int


def attempts(
    agent: Agent,
    k: int = 5,
    *,
    feedback: Feedback | None = None,
    games: Sequence[SceneLike] = GAMES,
    runs: int = 1,
    fps: int = 60,
    resets: int = 1,
    dtype: str = "float64",
    seed: int = 0,
) -> Attempts:
    """Let an agent try each game k times.

    A blind agent gives its k plans at once. With feedback it gives one after the other, and sees all earlier attempts
    of its run. All k attempts are made, also after a success, for the best reward still counts. Each run of each game
    has random numbers of its own, so that the games asked for do not change each other's results. A trained policy's
    scores are those of its own rate, reset and number type; with others a few of its plans end otherwise.

    Args:
        agent: see `Agent`; its plans are played by the rule "simulate", as those of people are.
        k: attempts, 1 to 10,000.
        feedback: None (blind), "outcome", or "trajectory" (with the poses of all objects every 0.1 s).
        games: names, files or scenes.
        runs: how often the k attempts are made, with other random numbers.
        fps: physics steps a second; people play at 60.
        resets: number of the reset; 1 is a fresh space.
        dtype: of the physics.
        seed: of the agent's random numbers.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    check_whole("k", k, 1, MOST_ATTEMPTS)
    check_whole("runs", runs)
    check_whole("seed", seed, 0, MAX_SEED)
    rate = whole_fps(fps)
    if feedback is not None:
        check_option("feedback", feedback, FEEDBACK)
    if feedback == "trajectory" and rate % DECISIONS_PER_SECOND:
        raise ValueError(f"fps: expected a multiple of {DECISIONS_PER_SECOND} for trajectories, got {show(fps)}")
    court = _Court(load_scenes(games), rate, check_resets(resets), check_dtype(dtype), feedback == "trajectory")
    tries = [_Run(agent, index, scene, run, seed) for index, scene in enumerate(court.scenes) for run in range(runs)]
    rounds = [k] if feedback is None else [1] * k
    for count in rounds:
        court.play(tries, count)
    shape = (len(court.scenes), runs, k)
    past = [attempt for each in tries for attempt in each.past]
    return Attempts(
        games=tuple(scene.name for scene in court.scenes),
        success=np.array([attempt.success for attempt in past]).reshape(shape),
        reward=np.array([attempt.reward for attempt in past]).reshape(shape),
        eliminations=np.array([attempt.eliminations for attempt in past]).reshape(shape),
        seconds=np.array([attempt.seconds for attempt in past]).reshape(shape),
        faults=sum(each.faults for each in tries),
    )


class _Run:
    """The k attempts of one agent at one game."""

    def __init__(self, agent: Agent, index: int, scene: Scene, run: int, seed: int) -> None:
        name = list(scene.name.encode())  # not the index: the other games must not matter
        self.index, self.scene, self._agent = index, scene, agent
        self._rng = np.random.default_rng([seed, run, *name])
        self.past: list[Attempt] = []
        self.faults = 0

    def propose(self, count: int) -> Floats:
        """Ask the agent for plans, (count, S) s."""
        shape = (count, len(self.scene.eliminable_blocks))
        wanted = f"plans of shape {shape} for {self.scene.name}"
        times = as_floats("agent", self._agent(self.scene, count, self._rng, tuple(self.past)), wanted)
        if times.shape != shape:
            raise ValueError(f"agent: expected {wanted}, got {times.shape}")
        if not (np.isnan(times) | (np.isfinite(times) & (times >= 0))).all():
            raise ValueError(f"agent: expected times from 0 on, or NaN, for {self.scene.name}, got others")
        return times


@dataclass(frozen=True)
class _Court:
    """Plays what the runs propose, all at once."""

    scenes: tuple[Scene, ...]
    fps: int
    resets: int
    dtype: str
    watched: bool  # whether poses are kept

    def play(self, runs: Sequence[_Run], count: int) -> None:
        """Let each run propose `count` plans, play them and add them to its past."""
        slots = max(len(scene.eliminable_blocks) for scene in self.scenes)
        proposed = [run.propose(count) for run in runs]
        times = np.full((len(runs) * count, slots), np.nan)
        for row, plans in enumerate(proposed):
            times[row * count : (row + 1) * count, : plans.shape[1]] = plans
        played = simulate_many(
            self.scenes,
            np.repeat([run.index for run in runs], count),
            plan_to_steps(times, self.fps, "simulate"),
            fps=self.fps,
            resets=self.resets,
            dtype=self.dtype,
            sample_every=self.fps // DECISIONS_PER_SECOND if self.watched else None,
        )
        for row, run in enumerate(runs):
            for j in range(count):
                at = row * count + j
                poses = None if played.samples is None else played.samples[at, :, : run.scene.n_objects]
                ended = (bool(played.success[at]), float(played.reward[at]), int(played.eliminations[at]))
                run.past.append(Attempt(proposed[row][j], *ended, float(played.steps[at]) / self.fps, poses))
                run.faults += int(played.fault[at] != 0)

"""The three strategies as plain loops over frames: the reference for the environments.

Each function follows the description of an official environment. It drives any object with the calls of the official
class: `reset()`, `step(position)` and `get_action_space()`. Only NumPy is needed, because the official class runs in a
virtual environment of its own (see `parity.official.record`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

FRAMES = 150  # of 0.1 s
SLOTS = 6
NO_CLICK = [0.0, 0.0]

Position = list[float]


class Clickable(Protocol):
    """The calls of the official class that the drivers use."""

    def reset(self) -> object:
        """Start again and return the table of objects, (12, 9)."""
        ...

    def step(self, pos: Position) -> tuple[object, float, bool]:
        """Click, play one frame and return table, reward, solved."""
        ...

    def get_action_space(self) -> list[Position]:
        """Reset and return seven positions: no click, the centres of the eliminable blocks, no click to fill up."""
        ...


@dataclass
class Transition:
    """The result of one `step` of an environment."""

    observation: NDArray[np.float32]
    reward: float
    terminated: bool
    truncated: bool


@dataclass
class Episode:
    """The observation at the start, then one transition for each action."""

    start: NDArray[np.float32]
    transitions: list[Transition] = field(default_factory=list)


def _observe(table: object, candidates: list[Position]) -> NDArray[np.float32]:
    """Divide lengths by the screen's side, clip to [0, 1] and append the candidate positions."""
    obs = np.array(table, np.float32)
    obs[:, :5] /= 600
    places = np.array(candidates, np.float32).reshape(-1) / 600
    return np.concatenate([obs.clip(0.0, 1.0).reshape(-1), places])


def in_advance(simulator: Clickable, actions: Iterator[NDArray[np.float32]]) -> Episode:
    """Play one in-advance episode; one action is taken."""
    table = simulator.reset()
    candidates = simulator.get_action_space()[1:]
    episode = Episode(_observe(table, candidates))
    times = np.round(next(actions) * np.float32(15), 1)
    total, solved = 0.0, False
    for frame in range(FRAMES):
        due: list[int] = np.flatnonzero(times == np.float32(frame / 10)).tolist() if frame else []
        table, reward, solved = simulator.step(candidates[due[0]] if due else NO_CLICK)
        total += reward
        if solved:
            break
    episode.transitions.append(Transition(_observe(table, candidates), total, solved, not solved))
    return episode


def on_the_fly(simulator: Clickable, actions: Iterator[int]) -> Episode:
    """Play one on-the-fly episode."""
    table = simulator.reset()
    candidates = simulator.get_action_space()
    episode = Episode(_observe(table, candidates))
    solved = False
    for frame in range(FRAMES):
        table, reward, solved = simulator.step(candidates[next(actions)])
        episode.transitions.append(Transition(_observe(table, candidates), reward, solved, frame + 1 >= FRAMES))
        if solved:
            break
    return episode


def combined(simulator: Clickable, actions: Iterator[NDArray[np.float32]], *, late_frame: bool = True) -> Episode:
    """Play one combined episode.

    Args:
        simulator: to play in.
        actions: as many as the episode takes.
        late_frame: keep the official clock; started at some frames, it counts a 151st frame.
    """
    table = simulator.reset()
    candidates = simulator.get_action_space()[1:]
    episode = Episode(_observe(table, candidates))
    free = [True] * SLOTS
    frame, solved = 0, False
    while frame < FRAMES and not solved:
        times = np.round(next(actions) * np.float32(15), 1)
        total = 0.0
        clock = np.arange(frame / 10, 15.0, 0.1) if late_frame else np.arange(frame, FRAMES) / 10
        for now in np.round(clock, 1):
            frame += 1
            due: list[int] = np.flatnonzero(times == np.float32(now)).tolist() if now > 0 else []
            click = NO_CLICK
            if due and free[due[0]]:
                click = candidates[due[0]]
                free[due[0]] = False
            table, reward, solved = simulator.step(click)
            total += reward
            if solved or click != NO_CLICK:
                break
        truncated = frame >= FRAMES and not solved
        episode.transitions.append(Transition(_observe(table, candidates), total, solved, truncated))
    return episode


DRIVERS: dict[str, Callable[..., Episode]] = {"in-advance": in_advance, "on-the-fly": on_the_fly, "combined": combined}


def random_actions(strategy: str, rng: np.random.Generator) -> Iterator[Any]:
    """Draw endless actions that test the rules: ties, never, the same slot twice, times in the past."""
    while True:
        if strategy == "on-the-fly":
            yield int(rng.integers(1, 7)) if rng.random() < 0.05 else 0
        else:
            action = rng.uniform(0.0, 1.0, SLOTS)
            shape = rng.random()
            if shape < 0.3:
                action = rng.integers(0, 151, SLOTS) / 150  # on the grid
            elif shape < 0.5:
                action = action * 0.3  # early
            if rng.random() < 0.3:
                action[rng.integers(0, SLOTS)] = action[rng.integers(0, SLOTS)]  # a tie
            if rng.random() < 0.3:
                action[rng.integers(0, SLOTS)] = rng.choice([0.0, 1.0])
            yield action.astype(np.float32)

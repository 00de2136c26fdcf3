"""Scores of the policies that ship with the package, read from their descriptions: greedy and sampled, game by game."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from iphyre_jax.files import file_sum, read_json_object
from iphyre_jax.train.storage.pretrained import WEIGHTS, names


@dataclass(frozen=True)
class Policy:
    """A shipped policy: the best of five seeds on the basic and unseen basic games.

    Attributes:
        name: as in the package: "ppo-i-smooth".
        settings: of its training.
        games: name of a game -> its scores: "greedy" and "sampled", each with reward, success, eliminations, seconds;
            in advance also "plan", s, None for never.
    """

    name: str
    settings: Mapping[str, Any]
    games: Mapping[str, Mapping[str, Any]]

    @property
    def fps(self) -> int:
        """Physics steps a second of its training and its scores."""
        return int(self.settings["fps"])

    @property
    def plans_ahead(self) -> bool:
        """Whether it acts in advance, so that its greedy plan is known."""
        return bool(self.settings["strategy"] == "in-advance")

    def values(self, kind: str, value: str = "reward") -> dict[str, float]:
        """Return a value of "greedy" or "sampled" episodes of each game."""
        return {game: float(scores[kind][value]) for game, scores in self.games.items()}

    def greedy_plan(self, game: str) -> list[int]:
        """Return the greedy plan in steps, -1 for never."""
        plan = self.games[game]["plan"]
        return [-1 if time is None else round(float(time) * self.fps) for time in plan]


def shipped_model(kind: str, name: str, weights: Path = WEIGHTS) -> dict[str, Any]:
    """Return settings of a row of a shipped model, with the sum of its weights: a row of an older one is out of date.

    Args:
        kind: "policy", or what else the model is.
        name: of the model.
        weights: folder of its kind.
    """
    return {kind: name, "sha256": file_sum(weights / f"{name}.npz"), "seed": 0}


@cache
def policies() -> tuple[Policy, ...]:
    """Return all shipped policies by name.

    Raises:
        ValueError, OSError: one line; a file is damaged.
    """
    found = []
    for name in names():
        content = read_json_object(WEIGHTS / f"{name}.json")
        games = {game["game"]: game for game in content["scores"]["games"]}
        found.append(Policy(name, content["settings"], games))
    return tuple(found)

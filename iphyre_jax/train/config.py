"""The settings of a training run, all of them, with their meaning."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from iphyre_jax.env import OFFICIAL_FPS, OFFICIAL_RESETS
from iphyre_jax.reward import whole_fps
from iphyre_jax.scenes import SPLITS

HeadName = Literal["slots", "gaussian"]


@dataclass(frozen=True)
class TrainConfig:
    """One training run of PPO that plans in advance. The defaults learn the basic split at 10 steps a second."""

    seed: int = 0
    """Seed of everything random: initial weights, sampled plans, minibatches, evaluation."""

    split: str = "basic"
    """Train on the games of this split, each equally often: basic, noisy, compositional, multi_ball or unseen_basic."""

    games: tuple[str, ...] = ()
    """Train on these games, by name, in place of a whole split."""

    fps: int = OFFICIAL_FPS
    """Physics steps a second: 10 is the paper's learning protocol, 60 is what people played. A multiple of 10."""

    resets: int = OFFICIAL_RESETS
    """Which filling of a reused space is played; it decides the order of contacts. The official one is the second."""

    dtype: Literal["float32", "float64"] = "float32"
    """Number type of the physics; the network is float32 always."""

    head: HeadName = "slots"
    """Distribution of a block's time. "slots": a categorical over never and every 0.1 s up to 14.9 s.
    "gaussian": a normal, clipped to [0 s, 15 s], as in the paper."""

    hidden: tuple[int, ...] = (256, 256)
    """Widths of the network's hidden layers (tanh)."""

    updates: int = 100
    """Rounds; in each, plans are sampled and played, then learned from."""

    plans_per_scene: int = 128
    """Plans that are sampled for each game in a round and compared with one another."""

    epochs: int = 4
    """How often a round learns from each of its plans."""

    minibatches: int = 4
    """Gradient steps in each epoch; must divide the number of plans of a round."""

    learning_rate: float = 1e-3
    """Adam's learning rate at the start; falls linearly to 0 over the run. The gaussian head wants less, about 3e-4."""

    max_grad_norm: float = 1.0
    """Gradients are scaled down to at most this global norm."""

    clip: float = 0.2
    """PPO: how far the probability ratio may leave 1 before its gradient stops."""

    entropy: float = 0.01
    """Weight of the entropy bonus (nats per block) at the start; falls linearly to 0 over the run."""

    std_floor: float = 30.0
    """Advantage of a plan = (reward - mean) / (standard deviation + this), within the plans of one game.
    The floor keeps a game whose plans differ by a few points from counting as much as one that some solve."""

    sampled_plans: int = 20
    """Plans of each game when the trained policy is evaluated with sampled actions."""

    def check(self) -> None:
        """Refuse what cannot work; every door by which settings come in calls this.

        Raises:
            ValueError: one line naming the field and what was expected.
        """
        if self.split not in SPLITS:
            raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {self.split!r}")
        known = {game for games in SPLITS.values() for game in games}
        for game in self.games:
            if game not in known:
                raise ValueError(f"games: expected names of games of the package, got {game!r}")
        if whole_fps(self.fps) % 10:
            raise ValueError(f"fps: expected a multiple of 10, got {self.fps}")
        if self.dtype not in ("float32", "float64"):
            raise ValueError(f"dtype: expected float32 or float64, got {self.dtype!r}")
        if self.head not in ("slots", "gaussian"):
            raise ValueError(f"head: expected slots or gaussian, got {self.head!r}")
        for name in ("resets", "updates", "epochs", "minibatches", "sampled_plans"):
            _require(self, name, getattr(self, name) >= 1, "at least 1")
        _require(self, "plans_per_scene", self.plans_per_scene >= 2, "at least 2")
        _require(self, "seed", 0 <= self.seed < 2**31, "from 0 to 2**31 - 1")
        _require(self, "hidden", len(self.hidden) > 0 and min(self.hidden) >= 1, "at least one positive width")
        for name in ("learning_rate", "max_grad_norm", "clip", "std_floor"):
            _require(self, name, 0 < getattr(self, name) < float("inf"), "a positive number")
        _require(self, "entropy", 0 <= self.entropy < float("inf"), "a number not below 0")
        episodes = self.episodes_per_update
        _require(self, "minibatches", episodes % self.minibatches == 0, f"a divisor of {episodes} plans a round")

    @property
    def training_games(self) -> tuple[str, ...]:
        """The games that are trained on."""
        return self.games or SPLITS[self.split]

    @property
    def episodes_per_update(self) -> int:
        """Episodes played in a round."""
        return len(self.training_games) * self.plans_per_scene

    def to_json(self) -> dict[str, Any]:
        """The settings as JSON values."""
        return dataclasses.asdict(self)


def _require(config: TrainConfig, name: str, holds: bool, expected: str) -> None:
    """Raise the one-line error of a field unless its condition holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {getattr(config, name)!r}")


def config_from_json(values: object, source: str | Path) -> TrainConfig:
    """The settings that `TrainConfig.to_json` wrote.

    Raises:
        ValueError: one line naming `source` and the field.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{source}: expected an object of settings, got {type(values).__name__}")
    known = {field.name: field.default for field in dataclasses.fields(TrainConfig)}
    settings: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{source}: unknown setting {name!r}")
        settings[name] = tuple(value) if isinstance(value, list) else value
        if not _same_kind(settings[name], known[name]):
            raise ValueError(f"{source}: {name}: expected a value like {known[name]!r}, got {value!r}")
    config = TrainConfig(**settings)
    try:
        config.check()
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    return config


def _same_kind(value: object, default: object) -> bool:
    """Whether a value read from JSON may stand for a field with this default."""
    if isinstance(default, tuple):
        kind = type(default[0]) if default else str
        return isinstance(value, tuple) and all(type(item) is kind for item in value)
    if isinstance(default, float):
        return type(value) in (int, float)
    return type(value) is type(default)

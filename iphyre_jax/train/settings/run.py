"""The settings of a training run, all of them, with their meaning."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from iphyre_jax.checks import whole_fps
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.rules import OFFICIAL_FPS, OFFICIAL_RESETS
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.scenes.limits import OFFICIAL
from iphyre_jax.train.algos.distributions import HeadName
from iphyre_jax.train.settings.agents import PPO, SETTINGS, AgentName, PolicyGradient, Settings

PresetName = Literal["default", "paper"]
Dtype = Literal["float32", "float64"]

PLANNED: Final = ("in-advance", "combined")  # strategies whose actions are times

# The agents of the paper: which algorithm there is for which strategy.
AGENTS: Final[Mapping[AgentName, tuple[StrategyName, ...]]] = MappingProxyType(
    {
        "ppo": ("in-advance", "on-the-fly", "combined"),
        "a2c": ("in-advance", "on-the-fly", "combined"),
        "sac": ("in-advance", "on-the-fly", "combined"),
        "ddpg": ("in-advance",),
        "dqn": ("on-the-fly",),
        "random": ("in-advance", "on-the-fly", "combined"),
    }
)


@dataclass(frozen=True)
class TrainConfig:
    """One training run. The defaults are the default preset of PPO in advance."""

    agent: AgentName = "ppo"
    """Algorithm; "random" learns nothing and is there to compare with."""

    strategy: StrategyName = "in-advance"
    """When blocks are chosen: all times at the start, one of seven actions every 0.1 s, or all times anew after each
    removal. DDPG plans in advance only, DQN acts on the fly only."""

    preset: PresetName = "default"
    """Where the other settings come from unless given: "default", ours; "paper", the paper's as far as they can be
    said."""

    seed: int = 0
    """Seed of everything random: initial weights, sampled actions, minibatches, evaluation."""

    split: str = "basic"
    """Train on the games of this split, each equally often: basic, noisy, compositional, multi_ball or unseen_basic."""

    games: tuple[str, ...] = ()
    """Train on these games, by name or scene file, in place of a whole split."""

    variations: int = 0
    """Shifted, mirrored, stretched and jittered copies of each game that are trained on beside it (in advance only)."""

    added_blocks: int = 0
    """Variations get from none up to so many further static blocks at random places."""

    fps: int = OFFICIAL_FPS
    """Physics steps a second: 10 is the paper's learning protocol, 60 is what people played. A multiple of 10."""

    resets: int = OFFICIAL_RESETS
    """Which filling of a reused space is played; it decides the order of contacts. The official one is the second."""

    dtype: Dtype = "float32"
    """Number type of the physics; networks are float32 always. "float64" in advance only."""

    observation: Literal["official", "motion"] = "official"
    """What the agent sees: the official rows, or the same with velocities and time."""

    head: HeadName = "slots"
    """Distribution of a decision. Times: "slots", a categorical over never and every 0.1 s up to 14.9 s; "gaussian", a
    normal, clipped to [0 s, 15 s], as in the paper; "squashed", a normal pressed into it (SAC); "point", no chance at
    all (DDPG). On the fly: "categorical", which at first does nothing 97 times in 100; "even", at first all alike."""

    network: Literal["perceptron", "objects"] = "perceptron"
    """"perceptron" reads the observation as one list of numbers; "objects" attends from object to object."""

    centred: bool = True
    """A perceptron sees observations less the mean of those that the training games begin with, times 2."""

    hidden: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers; of an object network, width of each round of attention."""

    activation: Literal["tanh", "relu"] = "tanh"
    """Of the hidden layers of a perceptron."""

    updates: int = 60
    """Rounds; in each, episodes are played, then learned from."""

    episodes_per_scene: int = 128
    """Episodes of each game in a round."""

    sampled_episodes: int = 20
    """Episodes of each game when the trained policy is evaluated with sampled actions."""

    greedy_every: int = 10
    """Rounds between measurements of the greedy policy, for the learning curve."""

    checkpoint_seconds: float = 20.0
    """Least time between checkpoints, s; 0 for one after each round. There is one at the end always."""

    tensorboard: bool = False
    """Write TensorBoard files beside metrics.csv. Needs the extra `tensorboard`."""

    learner: Settings = field(default_factory=PPO)
    """Settings of the algorithm."""

    def check(self) -> None:
        """Refuse what cannot work; every door by which settings come in calls this.

        Raises:
            ValueError: one line naming the field and what was expected.
        """
        _check_choices(self)
        _check_games(self)
        for name in ("resets", "updates", "sampled_episodes", "greedy_every"):
            _require(self, name, getattr(self, name) >= 1, "at least 1")
        for name in ("variations", "added_blocks"):
            _require(self, name, getattr(self, name) >= 0, "a number not below 0")
        _require(self, "episodes_per_scene", self.episodes_per_scene >= 2, "at least 2")
        _require(self, "seed", 0 <= self.seed < 2**31, "from 0 to 2**31 - 1")
        _require(self, "hidden", len(self.hidden) > 0 and min(self.hidden) >= 1, "at least one positive width")
        _require(self, "checkpoint_seconds", 0 <= self.checkpoint_seconds < float("inf"), "a number not below 0")
        _check_learner(self)

    @property
    def training_games(self) -> tuple[str, ...]:
        """The games that are trained on."""
        return self.games or SPLITS[self.split]

    @property
    def episodes_per_update(self) -> int:
        """Episodes played in a round."""
        return len(self.training_games) * self.episodes_per_scene

    def to_json(self) -> dict[str, Any]:
        """The settings as JSON values."""
        return dataclasses.asdict(self)


def _require(record: object, name: str, holds: bool, expected: str) -> None:
    """Raise the one-line error of a field unless its condition holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {getattr(record, name)!r}")


def _check_choices(config: TrainConfig) -> None:
    """Refuse names that do not exist, or not together."""
    for name, kind in _CHOICES.items():
        _require(config, name, getattr(config, name) in kind, f"one of {', '.join(kind)}")
    strategies = AGENTS[config.agent]
    _require(config, "strategy", config.strategy in strategies, f"{' or '.join(strategies)} with agent {config.agent}")
    heads = heads_for(config.agent, config.strategy)
    _require(config, "head", config.head in heads, f"{' or '.join(heads)} with {config.agent} {config.strategy}")
    gradient = issubclass(SETTINGS[config.agent], PolicyGradient)
    _require(config, "network", gradient or config.network == "perceptron", "perceptron unless with ppo or a2c")
    if config.strategy != "in-advance":
        _require(config, "dtype", config.dtype == "float32", "float32 unless in advance")
        _require(config, "variations", config.variations == 0, "0 unless in advance")
    else:
        _require(config, "observation", config.observation == "official", "official in advance: nothing moves yet")


def heads_for(agent: AgentName, strategy: StrategyName) -> tuple[HeadName, ...]:
    """The action heads that an agent can use."""
    if strategy == "on-the-fly":
        return ("categorical", "even")
    heads: dict[AgentName, tuple[HeadName, ...]] = {"sac": ("squashed",), "ddpg": ("point",)}
    return heads.get(agent, ("slots", "gaussian"))


def _check_games(config: TrainConfig) -> None:
    """Refuse games that do not exist, scene files that are not valid and rates that do not fit."""
    known = {game for games in SPLITS.values() for game in games}
    for game in set(config.games) - known:
        if not Path(game).is_file():
            raise ValueError(f"games: expected names of games of the package or scene files, got {game!r}")
        if load_scene(game).limits != OFFICIAL:
            raise ValueError(
                f"games: expected scenes without limits of their own, for the networks' sizes, got {game!r}"
            )
    if whole_fps(config.fps) % 10:
        raise ValueError(f"fps: expected a multiple of 10, got {config.fps}")


def _check_learner(config: TrainConfig) -> None:
    """Refuse settings of the algorithm that cannot work."""
    learner, kind = config.learner, SETTINGS[config.agent]
    if type(learner) is not kind:
        raise ValueError(f"learner: expected settings of {config.agent}, got {type(learner).__name__}")
    for entry in dataclasses.fields(learner):
        value, least = getattr(learner, entry.name), _LEAST.get(entry.name, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float) or entry.name in _SIGNED:
            continue
        finite = least <= value < float("inf") and (value > 0 or entry.name not in _POSITIVE)
        expected = "a positive number" if entry.name in _POSITIVE else f"a number not below {least:g}"
        _require(learner, entry.name, finite, expected)
    if isinstance(learner, PolicyGradient):
        _require(learner, "normalise", learner.normalise in ("scene", "batch", "none"), "scene, batch or none")
        if config.strategy == "in-advance" or learner.rows:
            rows = learner.rows or config.episodes_per_update
            divides = rows % learner.minibatches == 0
            _require(learner, "minibatches", divides, f"a divisor of {rows} decisions a round")
        else:
            raise ValueError("rows: expected a number of decisions unless in advance, got 0")


_CHOICES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "agent": get_args(AgentName),
        "strategy": get_args(StrategyName),
        "preset": get_args(PresetName),
        "split": tuple(SPLITS),
        "dtype": get_args(Dtype),
        "observation": ("official", "motion"),
        "head": get_args(HeadName),
        "network": ("perceptron", "objects"),
        "activation": ("tanh", "relu"),
    }
)
_LEAST: Final = MappingProxyType(
    dict.fromkeys(("minibatches", "epochs", "n_step", "replay", "batch", "steps", "noise_rounds"), 1.0)
    | {"epsilon_rounds": 1.0}
)
_POSITIVE: Final = frozenset({"learning_rate", "actor_rate", "max_grad_norm", "clip", "std_floor", "alpha"})
_SIGNED: Final = frozenset({"target_entropy"})


def config_from_json(values: object, source: str | Path) -> TrainConfig:
    """The settings that `TrainConfig.to_json` wrote.

    Raises:
        ValueError: one line naming `source` and the field.
    """
    if not isinstance(values, dict):
        raise ValueError(f"{source}: expected an object of settings, got {type(values).__name__}")
    agent = values.get("agent", TrainConfig.agent)
    kind = dict[Any, type[Settings]](SETTINGS).get(agent) if isinstance(agent, str) else None
    if kind is None:
        raise ValueError(f"{source}: agent: expected one of {', '.join(SETTINGS)}, got {agent!r}")
    learner = _fields(kind(), values.get("learner", {}), source)
    plain = {name: value for name, value in values.items() if name != "learner"}
    config = _fields(TrainConfig(learner=learner), plain, source)
    try:
        config.check()
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None
    return config


def _fields(default: Any, values: object, source: str | Path) -> Any:  # noqa: ANN401 - any dataclass, and the same back
    """A dataclass with fields read from JSON, each of the kind of its default."""
    if not isinstance(values, dict):
        raise ValueError(f"{source}: learner: expected an object of settings, got {type(values).__name__}")
    known = {entry.name: getattr(default, entry.name) for entry in dataclasses.fields(default)}
    settings: dict[str, Any] = {}
    for name, value in values.items():
        if name not in known:
            raise ValueError(f"{source}: unknown setting {name!r}")
        settings[name] = tuple(value) if isinstance(value, list) else value
        if not _same_kind(settings[name], known[name]):
            raise ValueError(f"{source}: {name}: expected a value like {known[name]!r}, got {value!r}")
    return dataclasses.replace(default, **settings)


def _same_kind(value: object, default: object) -> bool:
    """Whether a value read from JSON may stand for a field with this default."""
    if isinstance(default, tuple):
        kind = type(default[0]) if default else str
        return isinstance(value, tuple) and all(type(item) is kind for item in value)
    if isinstance(default, float):
        return type(value) in (int, float)
    return type(value) is type(default)

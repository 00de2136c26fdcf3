"""The settings of a training run, all of them, with their meaning."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from iphyre_jax.checks import MAX_RESETS, show, whole_fps
from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.rules import OFFICIAL_FPS, OFFICIAL_RESETS
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.scenes.limits import OFFICIAL
from iphyre_jax.train.settings.agents import PPO, AdvantageScope, AgentName, HeadName, PolicyGradient, Settings
from iphyre_jax.train.settings.presets import AGENTS, PresetName

ZEROS, PERFECT = "zeros", "perfect"  # predictions that no world model makes
Dtype = Literal["float32", "float64"]

MAX_WIDTH, MAX_LAYERS = 4096, 16  # of a network
MAX_COUNT: Final = 10**8  # of a learner's whole numbers
STRATEGY_LETTERS: Final = MappingProxyType({"in-advance": "I", "on-the-fly": "O", "combined": "C"})


@dataclass(frozen=True)
class TrainConfig:
    """One training run. The defaults are the quick preset of PPO in advance."""

    agent: AgentName = "ppo"
    """Algorithm; "random" learns nothing and serves for comparison."""

    strategy: StrategyName = "in-advance"
    """When blocks are chosen: all times at the start, one of seven actions every 0.1 s, or all times anew after each
    removal. DDPG plans in advance only, DQN acts on the fly only."""

    preset: PresetName = "quick"
    """Source of the settings that are not given: "default", ours; "quick", ours without what takes PPO in advance
    beyond the games that it trains on; "paper", the paper's as far as they are known."""

    seed: int = 0
    """Seed of everything random: initial weights, sampled actions, minibatches, evaluation."""

    split: str = "basic"
    """Train on the games of this split, each equally often: basic, noisy, compositional, multi_ball or unseen_basic."""

    games: tuple[str, ...] = ()
    """Train on these games, by name or scene file, instead of a whole split."""

    variations: int = 0
    """Shifted, mirrored, stretched and jittered copies of each game to train on as well (in advance only)."""

    added_blocks: int = 0
    """Add up to so many static blocks to the variations, at random places."""

    scene_pool: str = ""
    """Generated scenes to train on as well (in advance only): "shipped", those of the package, or a file, NAME.npz of
    `iphyre-jax generate`."""

    pool_sha256: str = ""
    """SHA-256 sum of that file. A run writes it down when it starts, and resumes with no other file."""

    pool_scenes: int = 1000
    """Train on the first so many scenes of the file; the others can be held out."""

    pool_share: float = 0.5
    """Share of the episodes that the pool gets; 1 for all."""

    curriculum: Literal["learnability", "uniform"] = "learnability"
    """How scenes of the pool are drawn: in proportion to p (1 - p), where the policy solves a share p of episodes, and
    some that it never played; or all alike."""

    fps: int = OFFICIAL_FPS
    """Physics steps a second: 10 is the paper's learning protocol, 60 is what people played. A multiple of 10."""

    resets: int = OFFICIAL_RESETS
    """Number of the reset of a reused space. It decides the order of contacts. Official agents play in the second."""

    dtype: Dtype = "float32"
    """Number type of the physics; networks are always float32. "float64" in advance only."""

    observation: Literal["official", "motion"] = "official"
    """What the agent sees: the official rows, or the same with velocities and time."""

    prediction: str = ""
    """What the observation ends with: the official table 0.1 s later if nothing is removed now (not in advance; "mlp"
    only). "zeros", as many zeros; "perfect", as the simulator says; or by a world model, which learned at 60 steps a
    second: its name in the package, or its run folder."""

    prediction_sha256: str = ""
    """SHA-256 sum of that world model. A run writes it down when it starts, and resumes with no other one."""

    head: HeadName = "time_grid"
    """Distribution of a decision. For times: "time_grid", a categorical over never and every 0.1 s up to 14.9 s;
    "gaussian", a normal clipped to [0 s, 15 s], as in the paper; "tanh_normal", a normal squashed into it (SAC);
    "deterministic" (DDPG). On the fly: "categorical", which starts by doing nothing 97 times in 100; "uniform", which
    starts with equal probabilities."""

    network: Literal["mlp", "objects"] = "mlp"
    """"mlp" reads the observation as one list of numbers; "objects" attends from object to object."""

    center_obs: bool = True
    """Subtract the mean of the training games' first observations and double the rest ("mlp" only)."""

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers; with "objects", widths of the attention blocks."""

    activation: Literal["tanh", "relu"] = "tanh"
    """Activation of the hidden layers ("mlp" only)."""

    updates: int = 60
    """Updates; each plays episodes, then learns from them."""

    episodes_per_scene: int = 128
    """Episodes of each game in an update."""

    sampled_episodes: int = 20
    """Episodes of each game when the trained policy is evaluated with sampled actions."""

    greedy_every: int = 10
    """Updates between measurements of the greedy policy, for the learning curve."""

    checkpoint_seconds: float = 20.0
    """Least time between checkpoints, s; 0 for one after each update. The end always has one."""

    tensorboard: bool = False
    """Write TensorBoard files beside metrics.csv. Needs the extra `tensorboard`."""

    learner: Settings = field(default_factory=PPO)
    """Settings of the algorithm."""

    def check(self) -> None:
        """Refuse what cannot work; whatever takes in settings calls this.

        Raises:
            ValueError: one line naming the field and what was expected.
        """
        _check_choices(self)
        _check_games(self)
        for name in ("resets", "updates", "sampled_episodes", "greedy_every"):
            _require(self, name, getattr(self, name) >= 1, "at least 1")
        for name in ("variations", "added_blocks"):
            _require(self, name, getattr(self, name) >= 0, "a number not below 0")
        _require(self, "resets", self.resets <= MAX_RESETS, f"at most {MAX_RESETS}")
        _require(self, "episodes_per_scene", self.episodes_per_scene >= 2, "at least 2")
        _require(self, "seed", 0 <= self.seed < 2**31, "from 0 to 2**31 - 1")
        widths = len(self.hidden_sizes) > 0 and min(self.hidden_sizes) >= 1
        _require(self, "hidden_sizes", widths, "at least one positive width")
        for name, most in _MOST.items():
            _require(self, name, getattr(self, name) <= most, f"at most {most}")
        depth = len(self.hidden_sizes) <= MAX_LAYERS and max(self.hidden_sizes) <= MAX_WIDTH
        _require(self, "hidden_sizes", depth, f"at most {MAX_LAYERS} widths of at most {MAX_WIDTH}")
        _require(self, "checkpoint_seconds", 0 <= self.checkpoint_seconds < float("inf"), "a number not below 0")
        _check_pool(self)
        _check_prediction(self)
        _check_learner(self)

    @property
    def training_games(self) -> tuple[str, ...]:
        """The games to train on."""
        return self.games or SPLITS[self.split]

    @property
    def episodes_per_update(self) -> int:
        """Episodes played in an update."""
        return len(self.training_games) * self.episodes_per_scene

    @property
    def paper_name(self) -> str:
        """The paper's name for the agent: PPO-I, Random."""
        title = AGENTS[self.agent].title
        return title if self.agent == "random" else f"{title}-{STRATEGY_LETTERS[self.strategy]}"

    @property
    def agent_name(self) -> str:
        """The agent's name in results: algorithm, strategy, preset, observation, action head, rate, seed."""
        return (
            f"{AGENTS[self.agent].title} {self.strategy}, {self.preset} preset, {self.observation} observation, "
            f"{f'prediction {self.prediction}, ' if self.prediction else ''}"
            f"{self.head} head, {self.fps} fps, seed {self.seed}"
        )

    def to_json(self) -> dict[str, Any]:
        """The settings as JSON values."""
        return dataclasses.asdict(self)


def preset(
    agent: AgentName = "ppo", strategy: StrategyName = "in-advance", name: PresetName = "default"
) -> TrainConfig:
    """The settings of a preset.

    Raises:
        ValueError: one line; there is no such preset, or no such agent for the strategy.
    """
    if name not in get_args(PresetName):
        raise ValueError(f"preset: expected one of {', '.join(get_args(PresetName))}, got {name!r}")
    if agent not in AGENTS or strategy not in AGENTS[agent].strategies:
        known = ", ".join(f"{one} {other}" for one, spec in AGENTS.items() for other in spec.strategies)
        raise ValueError(f"agent, strategy: expected one of {known}; got {agent} {strategy}")
    base = TrainConfig(agent=agent, strategy=strategy, preset=name, center_obs=name != "paper")
    return dataclasses.replace(base, **AGENTS[agent].presets(name)[strategy])


def _require(record: object, name: str, holds: bool, expected: str) -> None:
    """Raise the one-line error of a field unless its condition holds."""
    if not holds:
        raise ValueError(f"{name}: expected {expected}, got {show(getattr(record, name))}")


def _check_choices(config: TrainConfig) -> None:
    """Refuse names that do not exist, or not together."""
    for name, known in _CHOICES.items():
        _require(config, name, getattr(config, name) in known, f"one of {', '.join(known)}")
    spec = AGENTS[config.agent]
    possible = config.strategy in spec.strategies
    _require(config, "strategy", possible, f"{' or '.join(spec.strategies)} with agent {config.agent}")
    heads = spec.heads(config.strategy)
    _require(config, "head", config.head in heads, f"{' or '.join(heads)} with {config.agent} {config.strategy}")
    gradient = issubclass(spec.settings, PolicyGradient)
    _require(config, "network", gradient or config.network == "mlp", "mlp unless with ppo or a2c")
    if config.strategy != "in-advance":
        _require(config, "dtype", config.dtype == "float32", "float32 unless in advance")
        _require(config, "variations", config.variations == 0, "0 unless in advance")
    else:
        _require(config, "observation", config.observation == "official", "official in advance: nothing moves yet")


def _check_games(config: TrainConfig) -> None:
    """Refuse games that do not exist, scene files that are not valid and rates that do not fit."""
    known = {game for games in SPLITS.values() for game in games}
    for game in set(config.games) - known:
        if not Path(game).is_file():
            raise ValueError(f"games: expected names of games of the package or scene files, got {show(game)}")
        if load_scene(game).limits != OFFICIAL:
            raise ValueError(
                f"games: expected scenes without limits of their own, for the networks' sizes, got {game!r}"
            )
    if whole_fps(config.fps) % 10:
        raise ValueError(f"fps: expected a multiple of 10, got {config.fps}")


def _check_pool(config: TrainConfig) -> None:
    """Refuse a pool that cannot be; its file is looked at when a run starts."""
    if config.strategy != "in-advance" or not config.scene_pool:
        _require(config, "scene_pool", not config.scene_pool, "none unless in advance")
        _require(config, "pool_sha256", not config.pool_sha256, "none without a scene_pool")
    _require(config, "pool_scenes", config.pool_scenes >= 1, "at least 1")
    _require(config, "pool_share", 0 < config.pool_share <= 1, "a number above 0 and at most 1")


def _check_prediction(config: TrainConfig) -> None:
    """Refuse a prediction that cannot be; its world model is looked at when a run starts."""
    if not config.prediction:
        _require(config, "prediction_sha256", not config.prediction_sha256, "none without a prediction")
        return
    _require(config, "prediction", config.strategy != "in-advance", "none in advance: nothing moves yet")
    _require(config, "network", config.network == "mlp", "mlp with a prediction")
    by_model = config.prediction not in (ZEROS, PERFECT)
    _require(config, "fps", not by_model or config.fps == 60, "60 with a world model, which learned at that rate")


def _check_learner(config: TrainConfig) -> None:
    """Refuse settings of the algorithm that cannot work."""
    learner, known = config.learner, AGENTS[config.agent].settings
    if type(learner) is not known:
        raise ValueError(f"learner: expected settings of {config.agent}, got {type(learner).__name__}")
    for entry in dataclasses.fields(learner):
        value = getattr(learner, entry.name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            continue
        positive, least = "positive" in entry.metadata, entry.metadata.get("least", 0)
        finite = least <= value < float("inf") and (value > 0 or not positive)
        _require(learner, entry.name, finite, "a positive number" if positive else f"a number not below {least}")
        _require(learner, entry.name, isinstance(value, float) or value <= MAX_COUNT, f"at most {MAX_COUNT}")
    if isinstance(learner, PolicyGradient):
        scopes = get_args(AdvantageScope)
        _require(learner, "normalize_advantage", learner.normalize_advantage in scopes, "scene, batch or none")
        if config.strategy != "in-advance" and not learner.samples_per_update:
            raise ValueError("samples_per_update: expected a number of decisions unless in advance, got 0")
        samples = learner.samples_per_update or config.episodes_per_update
        divides = samples % learner.minibatches == 0
        _require(learner, "minibatches", divides, f"a divisor of {samples} decisions an update")


_CHOICES: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "agent": get_args(AgentName),
        "strategy": get_args(StrategyName),
        "preset": get_args(PresetName),
        "split": tuple(SPLITS),
        "curriculum": ("learnability", "uniform"),
        "dtype": get_args(Dtype),
        "observation": ("official", "motion"),
        "head": get_args(HeadName),
        "network": ("mlp", "objects"),
        "activation": ("tanh", "relu"),
    }
)
_MOST: Final[Mapping[str, int]] = MappingProxyType(
    {
        "updates": 2**31 - 1,  # as a checkpoint counts them
        "checkpoint_seconds": 10**9,
        "episodes_per_scene": 10**6,
        "sampled_episodes": 10**6,
        "greedy_every": 2**31 - 1,
        "variations": 10**6,
        "pool_scenes": 10**6,
        "added_blocks": 64,
    }
)

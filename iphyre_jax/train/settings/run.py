"""The settings of a training run, all of them, with their meaning."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal, get_args

from iphyre_jax.envs.strategies import StrategyName, strategy_named
from iphyre_jax.rules import OFFICIAL_FPS, OFFICIAL_RESETS
from iphyre_jax.scenes import SPLITS
from iphyre_jax.train.settings.agents import PPO, AgentName, HeadName, Settings
from iphyre_jax.train.settings.checks import GROUP, check_config, check_start
from iphyre_jax.train.settings.presets import AGENTS, PresetName

ZEROS, PERFECT = "zeros", "perfect"  # predictions that no world model makes
Dtype = Literal["float32", "float64"]
STRATEGY_LETTERS: Final = MappingProxyType({"in-advance": "I", "on-the-fly": "O", "combined": "C"})


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a training run. In Python, `TrainConfig()` is `preset("ppo", "in-advance", "quick")`."""

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
    """Train on these games, by name or scene file, instead of a whole split. A run writes down the whole path of a
    file when it starts, and the sum of its scene."""

    variations: int = 0
    """Shifted, mirrored, stretched and jittered copies of each game to train on as well (in advance only). A game
    with fewer than 64 episodes of its own is played in half of the updates, a copy in the others."""

    added_blocks: int = 0
    """Add up to so many static blocks to the variations, at random places."""

    scene_pool: str = ""
    """Generated scenes to train on as well (in advance only): "shipped", those of the package, or a file, NAME.npz of
    `iphyre-jax generate`; several with commas between them."""

    pool_sha256: str = ""
    """SHA-256 sum of that file, or of the sums of several. A run writes it down when it starts, and resumes with no
    other file."""

    pool_scenes: int = 1000
    """Train on the first so many scenes of the file or files; the others can be held out."""

    pool_share: float = 0.5
    """Share of the episodes that the pool gets; 1 for all."""

    curriculum: Literal["learnability", "uniform"] = "learnability"
    """How scenes of the pool are drawn: in proportion to p (1 - p), where the policy solves a share p of episodes, and
    some that it never played; or all alike. With few `pool_topologies`, scenes of common topologies come more often."""

    pool_topologies: int = 4
    """The scenes that the pool gives to an update have at most so many topologies. Few keep the groups of worlds that
    play side by side full if an update has few episodes."""

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
    starts with equal probabilities and can choose slots without a block, which does nothing, as in the paper."""

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
        check_config(self)

    def check_start(self) -> None:
        """Refuse what cannot work, and what would not learn what its settings say; a new run calls this.

        Raises:
            ValueError: one line naming the field and what was expected.
        """
        check_config(self)
        check_start(self, preset(self.agent, self.strategy, self.preset))

    @property
    def training_games(self) -> tuple[str, ...]:
        """The games to train on."""
        return self.games or SPLITS[self.split]

    @property
    def episodes_per_update(self) -> int:
        """Episodes played in an update."""
        return len(self.training_games) * self.episodes_per_scene

    @property
    def decisions_per_update(self) -> int:
        """Decisions of an update, at most: those of episodes that end early are there and do not count."""
        return self.episodes_per_update * strategy_named(self.strategy).decisions

    @property
    def groups(self) -> int:
        """Groups of episodes of each game in an update, one scene each; 1 if only the games are played."""
        return max(1, self.episodes_per_scene // GROUP) if self.variations or self.scene_pool else 1

    @property
    def pool_groups(self) -> int:
        """Groups of each game that go to scenes of the pool: about its share, and at least one."""
        return max(1, round(self.pool_share * self.groups)) if self.scene_pool else 0

    @property
    def pool_paths(self) -> tuple[str, ...]:
        """The paths of the pool's files, in order."""
        return tuple(self.scene_pool.split(",")) if self.scene_pool else ()

    @property
    def world_model(self) -> str:
        """The world model that predicts: its name in the package, or its run folder; "" if none does."""
        return "" if self.prediction in (ZEROS, PERFECT) else self.prediction

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

"""What the trainer knows of each agent before it runs: its settings class, heads, and presets by strategy.

"default" is ours; docs/guide/training.md says on what it was chosen. PPO in advance is made for unseen scenes: what an
object is counts, not its row, and every update has other scenes, half of them basic games and variations of them, half
generated ones.

"quick" is the same, but PPO in advance is a perceptron that learns the ten games alone, in seconds.

"paper" follows the paper and the official code (RLlib's defaults where that code sets nothing). It differs in this:

* All episodes of an update are whole and begin together, and gradient steps follow; off policy, RLlib takes a gradient
  step after each decision or two. Rewards of failed episodes are never bootstrapped.
* Values, advantages, alpha and the entropy target of discrete SAC are in units of 1000 points, and losses are means. So
  A2C weighs the entropy with RLlib's 0.01 / 1000, three times that where actions are times: RLlib adds up the entropies
  of the blocks, and we average them. Its limit of the gradient's norm, 40 points for the sum over a batch, always binds
  there and hardly ever here. RLlib's value networks start near 0, ours some 200 points apart between games.
* Slots without a block count in no probability of times, so not in SAC's entropy: its target is -1 for each block,
  where RLlib asks -6 of all six slots together.
* SAC and DQN minimise squared errors; RLlib's loss is linear beyond an error of 1 point. DQN takes 1000 gradient steps
  in 4000 decisions, where RLlib takes one a decision, and has no layer of its own in its two streams. Its target
  network follows the learned one softly; RLlib's is copied every 500 decisions. Replay is uniform; RLlib's is
  prioritised.
* Discrete SAC diverges, in all seeds: its entropy stays just under the target of 1.9 nats (ln 7 is 1.95), so alpha, the
  weight of the entropy, grows without bound, and rewards drown in it.
* A2C takes a gradient step every 500 decisions; RLlib takes one every 32, with which ours collapses in the end (see
  `docs/decisions/training.md`). Its policy and value share no layers.
* DDPG's times reach from 0 to 15 s. RLlib maps them twice, so that its DDPG can only choose from 7.5 to 15 s. Ours ends
  at times that never remove, where its network has no gradient; within RLlib's bounds it ends at a plan as bad. Its
  noise is not correlated in time, and larger. Its replay is uniform, where RLlib's is prioritised.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, Literal

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.train.settings.agents import A2C, DDPG, DQN, PPO, SAC, AgentName, HeadName, Random, Settings

PresetName = Literal["default", "quick", "paper"]
Preset = Mapping[StrategyName, Mapping[str, Any]]  # fields of TrainConfig that differ from its defaults


@dataclass(frozen=True)
class AgentSpec:
    """An agent; `algos/registry.py` adds its algorithm."""

    title: str  # in tables
    settings: type[Settings]
    default: Preset  # its keys are the strategies that the agent can use
    paper: Preset
    quick: Preset = field(default_factory=dict)  # where it differs from `default`
    plan_heads: tuple[HeadName, ...] = ("time_grid", "gaussian")  # where actions are times

    @property
    def strategies(self) -> tuple[StrategyName, ...]:
        """The strategies that the agent can use."""
        return tuple(self.default)

    def heads(self, strategy: StrategyName) -> tuple[HeadName, ...]:
        """The action heads that the agent can use."""
        return ("categorical", "uniform") if strategy == "on-the-fly" else self.plan_heads

    def presets(self, name: PresetName) -> Preset:
        """A preset of each strategy."""
        return {"default": self.default, "quick": {**self.default, **self.quick}, "paper": self.paper}[name]


_UNSEEN: Final[dict[str, Any]] = {
    "network": "objects",
    "hidden_sizes": (96, 96, 96),
    "variations": 1000,
    "scene_pool": "shipped",
    "pool_scenes": 4000,
}
_FLY: Final[dict[str, Any]] = {"observation": "motion", "head": "categorical", "hidden_sizes": (128, 128)}
_CRITIC: Final[dict[str, Any]] = {"critic": True, "samples_per_update": 8192, "ent_coef": 0.003}
_EXPLORING: Final[dict[str, Any]] = {"ent_coef": 0.15, "std_floor": 10.0}  # else it removes blocks that might stay
_SMALL: Final[dict[str, Any]] = {"activation": "relu", "hidden_sizes": (128, 128), "episodes_per_scene": 32}
_SQUASHED: Final[dict[str, Any]] = {"activation": "relu", "head": "tanh_normal"}
_RLLIB: Final[dict[str, Any]] = {"anneal_lr": False, "critic": True, "gamma": 0.99, "gae_lambda": 1.0}
_RLLIB_A2C: Final[dict[str, Any]] = _RLLIB | {"max_grad_norm": 40.0, "normalize_advantage": "none", "ent_coef": 1e-5}
_TIMES_A2C: Final[dict[str, Any]] = _RLLIB_A2C | {"learning_rate": 1e-5, "ent_coef": 3e-5}
_RLLIB_PPO: Final[dict[str, Any]] = _RLLIB | {
    "learning_rate": 1e-6,
    "max_grad_norm": 1e9,
    "minibatches": 32,
    "epochs": 30,
    "clip_eps": 0.3,
    "ent_coef": 0.0,
    "vf_coef": 1.0,
    "value_clip": 10.0 / 1000.0**2,
    "kl_coef": 0.2,
    "normalize_advantage": "batch",
    "std_floor": 1e-6,
}
_PAPER_SAC: Final[dict[str, Any]] = {"warmup": 1500, "alpha": 1e-3, "gamma": 0.99}
_PAPER_DDPG: Final = DDPG(
    learning_rate=1e-3,
    actor_lr=1e-3,
    buffer_size=50_000,
    gradient_steps=1000,
    tau=0.002,
    noise=0.1,
    noise_end=0.002,
    noise_updates=10,
    random_updates=1,
    gamma=0.99,
)
_PAPER_DQN: Final = DQN(
    learning_rate=1e-6,
    buffer_size=50_000,
    batch_size=32,
    gradient_steps=1000,
    epsilon_updates=3,
    gamma=0.99,
    samples_per_update=4000,
)
_RANDOM: Final = {"learner": Random(), "updates": 1, "episodes_per_scene": 2}


def _run(learner: Settings, updates: int, episodes_per_scene: int, **others: object) -> dict[str, Any]:
    """The fields that most presets set."""
    return {"learner": learner, "updates": updates, "episodes_per_scene": episodes_per_scene, **others}


_PPO: Final = AgentSpec(
    "PPO",
    PPO,
    default={
        "in-advance": _run(PPO(learning_rate=4e-4, epochs=3, kl_coef=0.2), 300, 256, **_UNSEEN),
        "combined": _run(PPO(samples_per_update=1024, epochs=8), 50, 64),
        "on-the-fly": _run(PPO(**_CRITIC), 60, 32, **_FLY),
    },
    paper={
        "in-advance": _run(PPO(**_RLLIB_PPO), 200, 400, head="gaussian"),
        "combined": _run(PPO(**_RLLIB_PPO, samples_per_update=4096), 200, 160, head="gaussian"),
        "on-the-fly": _run(PPO(**_RLLIB_PPO, samples_per_update=4096), 200, 4, head="uniform"),
    },
    quick={"in-advance": {"learner": PPO()}},
)
_A2C: Final = AgentSpec(
    "A2C",
    A2C,
    default={
        "in-advance": _run(A2C(**_EXPLORING), 300, 32),
        "combined": _run(A2C(**_EXPLORING, samples_per_update=512), 300, 32),
        "on-the-fly": _run(A2C(**_CRITIC, minibatches=16), 40, 32, **_FLY),
    },
    paper={
        "in-advance": _run(A2C(**_TIMES_A2C), 852, 50, head="gaussian"),
        "combined": _run(A2C(**_TIMES_A2C, samples_per_update=500), 1600, 20, head="gaussian"),
        "on-the-fly": _run(
            A2C(**_RLLIB_A2C, learning_rate=1e-6, minibatches=8, samples_per_update=4000), 200, 4, head="uniform"
        ),
    },
)
_SAC: Final = AgentSpec(
    "SAC",
    SAC,
    plan_heads=("tanh_normal",),
    default={
        "in-advance": _SMALL | {"head": "tanh_normal", "learner": SAC(learning_rate=1e-3)},
        "combined": _SMALL
        | {
            "head": "tanh_normal",
            "updates": 100,
            "learner": SAC(learning_rate=1e-3, n_step=7, gradient_steps=256),  # an episode has at most 7 decisions
        },
        "on-the-fly": _run(
            SAC(n_step=50, gradient_steps=128, target_entropy=0.1, alpha=0.01), 80, 8, activation="relu", **_FLY
        ),
    },
    paper={
        "in-advance": _run(SAC(**_PAPER_SAC, gradient_steps=100, buffer_size=60_000), 570, 10, **_SQUASHED),
        "combined": _run(SAC(**_PAPER_SAC, gradient_steps=250, buffer_size=80_000), 320, 10, **_SQUASHED),
        "on-the-fly": _run(
            SAC(**_PAPER_SAC, gradient_steps=2500, target_entropy=1.9, buffer_size=80_000),
            32,
            2,
            activation="relu",
            head="uniform",
        ),
    },
)
_DDPG: Final = AgentSpec(
    "DDPG",
    DDPG,
    plan_heads=("deterministic",),
    default={"in-advance": _SMALL | {"head": "deterministic", "learner": DDPG(learning_rate=1e-3, noise_updates=40)}},
    paper={"in-advance": _run(_PAPER_DDPG, 800, 100, head="deterministic", activation="relu", hidden_sizes=(400, 300))},
)
_DQN: Final = AgentSpec(
    "DQN",
    DQN,
    default={
        "on-the-fly": _run(
            DQN(n_step=10, gradient_steps=256, no_op_prob=0.9, epsilon_end=0.01, epsilon_updates=25),
            40,
            8,
            activation="relu",
            **_FLY,
        )
    },
    paper={"on-the-fly": _run(_PAPER_DQN, 200, 4, head="uniform")},
)
_RANDOM_AGENT: Final = AgentSpec(
    "Random",
    Random,
    default={
        "in-advance": _RANDOM,
        "combined": _RANDOM,
        "on-the-fly": _RANDOM | {"head": "categorical", "observation": "motion"},
    },
    paper={"in-advance": _RANDOM, "combined": _RANDOM, "on-the-fly": _RANDOM | {"head": "uniform"}},
)

AGENTS: Final[Mapping[AgentName, AgentSpec]] = MappingProxyType(
    {"ppo": _PPO, "a2c": _A2C, "sac": _SAC, "ddpg": _DDPG, "dqn": _DQN, "random": _RANDOM_AGENT}
)

"""What the trainer knows of each agent before it runs: its settings class, heads, and presets by strategy.

"default" is ours, chosen on the basic split, on jittered copies of it and on the unseen basic layouts only.

"paper" follows the paper and the official code (RLlib's defaults where that code sets nothing). It differs in this: all
episodes of an update are whole and begin together; replay is uniform, RLlib's is prioritised; DDPG's noise is not
correlated in time, which has no meaning in advance; alpha and the entropy target of discrete SAC are in units of 1000
points; rewards of failed episodes are never bootstrapped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Literal

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.train.settings.agents import A2C, DDPG, DQN, PPO, SAC, AgentName, HeadName, Random, Settings

PresetName = Literal["default", "paper"]
Preset = Mapping[StrategyName, Mapping[str, Any]]  # fields of TrainConfig that differ from its defaults


@dataclass(frozen=True)
class AgentSpec:
    """An agent; `algos/registry.py` adds its algorithm."""

    title: str  # in tables
    settings: type[Settings]
    default: Preset  # its keys are the strategies that the agent can use
    paper: Preset
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
        return self.default if name == "default" else self.paper


_FLY: Final[dict[str, Any]] = {
    "observation": "motion",
    "head": "categorical",
    "hidden_sizes": (128, 128),
    "episodes_per_scene": 32,
}
_CRITIC: Final[dict[str, Any]] = {"critic": True, "samples_per_update": 8192}
_EXPLORING: Final[dict[str, Any]] = {"ent_coef": 0.15, "std_floor": 10.0}  # else it removes blocks that might stay
_SMALL: Final[dict[str, Any]] = {"activation": "relu", "hidden_sizes": (128, 128), "episodes_per_scene": 32}
_RLLIB_PPO: Final[dict[str, Any]] = {
    "learning_rate": 1e-6,
    "anneal_lr": False,
    "max_grad_norm": 1e9,
    "minibatches": 32,
    "epochs": 30,
    "clip_eps": 0.3,
    "ent_coef": 0.0,
    "critic": True,
    "vf_coef": 1.0,
    "value_clip": 10.0 / 1000.0**2,
    "kl_coef": 0.2,
    "gamma": 0.99,
    "gae_lambda": 1.0,
    "normalize_advantage": "batch",
    "std_floor": 1e-6,
}
_RLLIB_A2C: Final[dict[str, Any]] = {
    "anneal_lr": False,
    "max_grad_norm": 40.0,
    "critic": True,
    "gamma": 0.99,
    "gae_lambda": 1.0,
    "normalize_advantage": "none",
}
_PAPER_SAC: Final[dict[str, Any]] = {"warmup": 1500, "alpha": 1e-3, "gamma": 0.99}
_UNIFORM: Final[dict[str, Any]] = {"head": "uniform", "episodes_per_scene": 4}
_RANDOM: Final[dict[str, Any]] = {"learner": Random(), "updates": 1, "episodes_per_scene": 2}

_PPO = AgentSpec(
    "PPO",
    PPO,
    default={
        "in-advance": {"learner": PPO()},
        "combined": {"learner": PPO(samples_per_update=1024, epochs=8), "episodes_per_scene": 64, "updates": 50},
        "on-the-fly": _FLY | {"learner": PPO(**_CRITIC, ent_coef=0.003)},
    },
    paper={
        "in-advance": {
            "head": "gaussian",
            "episodes_per_scene": 400,
            "updates": 200,
            "learner": PPO(**_RLLIB_PPO),
        },
        "combined": {
            "head": "gaussian",
            "episodes_per_scene": 160,
            "updates": 200,
            "learner": PPO(**_RLLIB_PPO, samples_per_update=4096),
        },
        "on-the-fly": _UNIFORM | {"updates": 200, "learner": PPO(**_RLLIB_PPO, samples_per_update=4096)},
    },
)
_A2C = AgentSpec(
    "A2C",
    A2C,
    default={
        "in-advance": {"learner": A2C(**_EXPLORING), "episodes_per_scene": 32, "updates": 300},
        "combined": {
            "learner": A2C(**_EXPLORING, samples_per_update=512),
            "episodes_per_scene": 32,
            "updates": 300,
        },
        "on-the-fly": _FLY | {"learner": A2C(**_CRITIC, ent_coef=0.003, minibatches=16), "updates": 40},
    },
    paper={
        "in-advance": {
            "head": "gaussian",
            "episodes_per_scene": 50,
            "updates": 852,
            "learner": A2C(**_RLLIB_A2C, learning_rate=1e-5),
        },
        "combined": {
            "head": "gaussian",
            "episodes_per_scene": 20,
            "updates": 1600,
            "learner": A2C(**_RLLIB_A2C, samples_per_update=500, learning_rate=1e-5),
        },
        "on-the-fly": _UNIFORM
        | {
            "updates": 200,
            "learner": A2C(**_RLLIB_A2C, minibatches=8, samples_per_update=4000, learning_rate=1e-6),
        },
    },
)
_SAC = AgentSpec(
    "SAC",
    SAC,
    plan_heads=("tanh_normal",),
    default={
        "in-advance": _SMALL | {"head": "tanh_normal", "learner": SAC(learning_rate=1e-3)},
        "combined": _SMALL | {"head": "tanh_normal", "updates": 100, "learner": SAC(learning_rate=1e-3)},
        "on-the-fly": _FLY
        | {
            "activation": "relu",
            "episodes_per_scene": 8,
            "updates": 40,
            "learner": SAC(n_step=10, target_entropy=0.1, alpha=0.01),
        },
    },
    paper={
        "in-advance": {
            "head": "tanh_normal",
            "activation": "relu",
            "episodes_per_scene": 10,
            "updates": 570,
            "learner": SAC(**_PAPER_SAC, gradient_steps=100, buffer_size=60_000),
        },
        "combined": {
            "head": "tanh_normal",
            "activation": "relu",
            "episodes_per_scene": 10,
            "updates": 320,
            "learner": SAC(**_PAPER_SAC, gradient_steps=250, buffer_size=80_000),
        },
        "on-the-fly": _UNIFORM
        | {
            "activation": "relu",
            "episodes_per_scene": 2,
            "updates": 32,
            "learner": SAC(**_PAPER_SAC, gradient_steps=2500, target_entropy=1.9, buffer_size=80_000),
        },
    },
)
_DDPG = AgentSpec(
    "DDPG",
    DDPG,
    plan_heads=("deterministic",),
    default={
        "in-advance": _SMALL | {"head": "deterministic", "learner": DDPG(learning_rate=1e-3, noise_updates=40)},
    },
    paper={
        "in-advance": {
            "head": "deterministic",
            "activation": "relu",
            "hidden_sizes": (400, 300),
            "episodes_per_scene": 100,
            "updates": 800,
            "learner": DDPG(
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
            ),
        },
    },
)
_DQN = AgentSpec(
    "DQN",
    DQN,
    default={
        "on-the-fly": _FLY
        | {
            "activation": "relu",
            "episodes_per_scene": 8,
            "learner": DQN(n_step=10, no_op_prob=0.9, epsilon_end=0.01, epsilon_updates=25),
            "updates": 40,
        },
    },
    paper={
        "on-the-fly": _UNIFORM
        | {
            "updates": 200,
            "learner": DQN(
                learning_rate=1e-6,
                buffer_size=50_000,
                batch_size=32,
                gradient_steps=1000,
                epsilon_updates=3,
                gamma=0.99,
                samples_per_update=4000,
            ),
        },
    },
)
_RANDOM_AGENT = AgentSpec(
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

"""Settings by agent, strategy and preset.

"default" is ours, chosen on the basic split, on jittered copies of it and on the unseen basic layouts only.

"paper" is the paper's and the official code's effective settings (RLlib's defaults where the code sets nothing), as far
as they can be said. What is different: all episodes of a round are whole and begin together; replay is uniform where
RLlib's is prioritised; DDPG's noise is not correlated in time, which in advance has no meaning; alpha, and with it the
entropy target of discrete SAC, is in units of 1000 points; rewards of failed episodes are never bootstrapped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.train.settings.agents import A2C, DDPG, DQN, PPO, SAC, AgentName, Random
from iphyre_jax.train.settings.run import PresetName, TrainConfig

Key = tuple[AgentName, StrategyName]
Table = Mapping[Key, Mapping[str, Any]]

_FLY: Final[dict[str, Any]] = {
    "observation": "motion",
    "head": "categorical",
    "hidden": (128, 128),
    "episodes_per_scene": 32,
}
_CRITIC: Final[dict[str, Any]] = {"critic": True, "rows": 8192, "discount": 1.0, "trace": 0.95}
_EXPLORING: Final[dict[str, Any]] = {"entropy": 0.15, "std_floor": 10.0}  # or it removes blocks that might stay

DEFAULT: Final[Table] = MappingProxyType(
    {
        ("ppo", "in-advance"): {"learner": PPO()},
        ("ppo", "combined"): {"learner": PPO(rows=1024, epochs=8), "episodes_per_scene": 64, "updates": 50},
        ("ppo", "on-the-fly"): _FLY | {"learner": PPO(**_CRITIC, learning_rate=1e-3, entropy=0.003), "updates": 60},
        ("a2c", "in-advance"): {"learner": A2C(**_EXPLORING), "episodes_per_scene": 32, "updates": 300},
        ("a2c", "combined"): {
            "learner": A2C(**_EXPLORING, rows=512),
            "episodes_per_scene": 32,
            "updates": 300,
        },
        ("a2c", "on-the-fly"): _FLY | {"learner": A2C(**_CRITIC, entropy=0.003, minibatches=16), "updates": 40},
        ("sac", "in-advance"): {
            "head": "squashed",
            "activation": "relu",
            "hidden": (128, 128),
            "episodes_per_scene": 32,
            "learner": SAC(learning_rate=1e-3),
        },
        ("sac", "combined"): {
            "head": "squashed",
            "activation": "relu",
            "hidden": (128, 128),
            "episodes_per_scene": 32,
            "updates": 100,
            "learner": SAC(learning_rate=1e-3),
        },
        ("sac", "on-the-fly"): _FLY
        | {
            "activation": "relu",
            "episodes_per_scene": 8,
            "updates": 40,
            "learner": SAC(n_step=10, target_entropy=0.1, alpha=0.01),
        },
        ("ddpg", "in-advance"): {
            "head": "point",
            "activation": "relu",
            "hidden": (128, 128),
            "episodes_per_scene": 32,
            "updates": 60,
            "learner": DDPG(learning_rate=1e-3, noise_rounds=40),
        },
        ("dqn", "on-the-fly"): _FLY
        | {
            "activation": "relu",
            "episodes_per_scene": 8,
            "learner": DQN(n_step=10, idle=0.9, epsilon_end=0.01, epsilon_rounds=25),
            "updates": 40,
        },
        ("random", "in-advance"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2},
        ("random", "combined"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2},
        ("random", "on-the-fly"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2}
        | {"head": "categorical", "observation": "motion"},  # of which it looks at nothing
    }
)

_RLLIB_PPO: Final[dict[str, Any]] = {
    "learning_rate": 1e-6,
    "anneal": False,
    "max_grad_norm": 1e9,
    "epochs": 30,
    "clip": 0.3,
    "entropy": 0.0,
    "critic": True,
    "value_weight": 1.0,
    "value_clip": 10.0 / 1000.0**2,
    "kl_weight": 0.2,
    "kl_target": 0.01,
    "discount": 0.99,
    "trace": 1.0,
    "normalise": "batch",
    "std_floor": 1e-6,
}
_RLLIB_A2C: Final[dict[str, Any]] = {
    "anneal": False,
    "max_grad_norm": 40.0,
    "entropy": 0.01,
    "critic": True,
    "value_weight": 0.5,
    "discount": 0.99,
    "trace": 1.0,
    "normalise": "none",
}
_EVEN: Final[dict[str, Any]] = {"head": "even", "episodes_per_scene": 4}

PAPER: Final[Table] = MappingProxyType(
    {
        ("ppo", "in-advance"): {
            "head": "gaussian",
            "episodes_per_scene": 400,
            "updates": 200,
            "learner": PPO(**_RLLIB_PPO, minibatches=32),
        },
        ("ppo", "combined"): {
            "head": "gaussian",
            "episodes_per_scene": 160,
            "updates": 200,
            "learner": PPO(**_RLLIB_PPO, minibatches=32, rows=4096),
        },
        ("ppo", "on-the-fly"): _EVEN | {"updates": 200, "learner": PPO(**_RLLIB_PPO, minibatches=32, rows=4096)},
        ("a2c", "in-advance"): {
            "head": "gaussian",
            "episodes_per_scene": 50,
            "updates": 852,
            "learner": A2C(**_RLLIB_A2C, minibatches=1, learning_rate=1e-5),
        },
        ("a2c", "combined"): {
            "head": "gaussian",
            "episodes_per_scene": 20,
            "updates": 1600,
            "learner": A2C(**_RLLIB_A2C, minibatches=1, rows=500, learning_rate=1e-5),
        },
        ("a2c", "on-the-fly"): _EVEN
        | {"updates": 200, "learner": A2C(**_RLLIB_A2C, minibatches=8, rows=4000, learning_rate=1e-6)},
        ("sac", "in-advance"): {
            "head": "squashed",
            "activation": "relu",
            "episodes_per_scene": 10,
            "updates": 570,
            "learner": SAC(steps=100, warmup=1500, alpha=1e-3, discount=0.99, replay=60_000),
        },
        ("sac", "combined"): {
            "head": "squashed",
            "activation": "relu",
            "episodes_per_scene": 10,
            "updates": 320,
            "learner": SAC(steps=250, warmup=1500, alpha=1e-3, discount=0.99, replay=80_000),
        },
        ("sac", "on-the-fly"): _EVEN
        | {
            "activation": "relu",
            "episodes_per_scene": 2,
            "updates": 32,
            "learner": SAC(steps=2500, warmup=1500, alpha=1e-3, target_entropy=1.9, discount=0.99, replay=80_000),
        },
        ("ddpg", "in-advance"): {
            "head": "point",
            "activation": "relu",
            "hidden": (400, 300),
            "episodes_per_scene": 100,
            "updates": 800,
            "learner": DDPG(
                learning_rate=1e-3,
                actor_rate=1e-3,
                replay=50_000,
                steps=1000,
                target_rate=0.002,
                noise=0.1,
                noise_end=0.002,
                noise_rounds=10,
                random_rounds=1,
                discount=0.99,
            ),
        },
        ("dqn", "on-the-fly"): _EVEN
        | {
            "updates": 200,
            "learner": DQN(
                learning_rate=1e-6, replay=50_000, batch=32, steps=1000, epsilon_rounds=3, discount=0.99, rows=4000
            ),
        },
        ("random", "in-advance"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2},
        ("random", "combined"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2},
        ("random", "on-the-fly"): {"learner": Random(), "updates": 1, "episodes_per_scene": 2, "head": "even"},
    }
)

PRESETS: Final[Mapping[PresetName, Table]] = MappingProxyType({"default": DEFAULT, "paper": PAPER})


def preset(
    agent: AgentName = "ppo", strategy: StrategyName = "in-advance", name: PresetName = "default"
) -> TrainConfig:
    """The settings of a preset.

    Raises:
        ValueError: one line; there is no such preset, or no such agent for the strategy.
    """
    if name not in PRESETS:
        raise ValueError(f"preset: expected one of {', '.join(PRESETS)}, got {name!r}")
    table = PRESETS[name]
    if (agent, strategy) not in table:
        known = ", ".join(f"{one} {other}" for one, other in table)
        raise ValueError(f"agent, strategy: expected one of {known}; got {agent} {strategy}")
    base = TrainConfig(agent=agent, strategy=strategy, preset=name, centred=name == "default")
    return replace(base, **table[agent, strategy])

"""The rows of the tables of results: which agents are trained, with which settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from types import MappingProxyType
from typing import Any, Final, Literal

from iphyre_jax.envs.strategies import StrategyName
from iphyre_jax.train.settings.agents import PPO, AgentName
from iphyre_jax.train.settings.presets import AGENTS
from iphyre_jax.train.settings.run import PERFECT, ZEROS, TrainConfig, preset

TableName = Literal["default", "paper", "controllers"]
CONTROLLERS: Final[tuple[AgentName, ...]] = ("ppo", "a2c", "sac")
MOVING: Final[tuple[StrategyName, ...]] = ("on-the-fly", "combined")  # see more than the start
PREDICTIONS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "none": {},
        "zeros": {"prediction": ZEROS},
        "mdrnn-400": {"prediction": "build/world/mdrnn-400-0"},
        "mdrnn-5000": {"prediction": "build/world/mdrnn-5000-0"},
        "objects": {"prediction": "build/world/objects-unlimited-0"},
        "perfect": {"prediction": PERFECT},
        "motion": {"observation": "motion"},
    }
)  # what an agent sees besides the official observation; run folders are those of `make results-world`
QUICK: Final = preset(name="quick")
SMOOTH: Final = replace(QUICK, fps=60, resets=1, updates=150, learner=PPO(std_floor=150.0, ent_coef=0.03))


def rows(name: TableName = "default") -> Mapping[str, TrainConfig]:
    """The rows of a table by name.

    "default" and "paper" have the twelve of the paper with that preset; "default" has our own rows besides. All but its
    last row learn the training games alone, as the paper's do. "controllers" has agents that see predictions.
    """
    if name == "controllers":
        return MappingProxyType(controllers())
    own = {"ppo-i": QUICK, "ppo-i-smooth": SMOOTH, "ppo-i-objects": preset()} if name == "default" else {}
    configs = [preset(agent, strategy, name) for agent, spec in AGENTS.items() for strategy in spec.strategies]
    suffix = "" if name == "default" else f"-{name}"
    # The random agent has one row: its last, on the fly.
    table = {config.paper_name.lower() + suffix: config for config in configs}
    return MappingProxyType(table | own)


def controllers() -> dict[str, TrainConfig]:
    """Agents that act on the fly or combined, with each of PREDICTIONS.

    World models learned at 60 steps a second in a fresh space: so the agents play there.
    """
    table = {}
    for agent, strategy in product(CONTROLLERS, MOVING):
        plain = replace(preset(agent, strategy), fps=60, resets=1, observation="official")
        for name, changes in PREDICTIONS.items():
            table[f"{plain.paper_name.lower()}-{name}"] = replace(plain, **changes)
    return table


def without_sums(config: TrainConfig) -> TrainConfig:
    """Settings without the sums of files, which a run writes down when it starts."""
    return replace(config, pool_sha256="", prediction_sha256="")

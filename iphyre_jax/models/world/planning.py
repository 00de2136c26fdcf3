"""Planning in a world model: what the best imagined plans bring when they are played, beside other planners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from iphyre_jax.attempts.agents import do_nothing, draw_randomly
from iphyre_jax.attempts.planner import Planner
from iphyre_jax.attempts.protocol import Agent, attempts
from iphyre_jax.files import read_versioned, replace_json
from iphyre_jax.models.world.imagine import WorldImagination, WorldPlanner
from iphyre_jax.models.world.interface import falls_until_contact
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import SPLITS

PLANNED: Final = ("basic", "noisy", "compositional", "multi_ball")
TRIES: Final = 5  # the first, and the best of so many
SEED: Final = 0  # of the drawn plans, the same ones for each model and each planner
DISPLACED: Final = 2.0  # px
BOUNDS_FILE: Final = "planning-bounds.json"
SCHEMA: Final = "iphyre_jax/world-planning-bounds"
VERSION: Final = 1


def model_planner(model: WorldModel, plans: int) -> Agent:
    """The agent that imagines in a trained model."""
    return WorldPlanner(WorldImagination(model), plans)


def bounding_agents(plans: int) -> Mapping[str, Agent]:
    """Agents to stand beside the models: some know no physics, some know it all."""
    falling = WorldImagination(WorldModel(WorldConfig(), (), {}), falls_until_contact)
    return {
        "doing nothing": do_nothing,
        "random plans": draw_randomly,
        "planner, free fall until contact": WorldPlanner(falling, plans),
        f"planner, simulator displaced by {DISPLACED:g} px": Planner(plans, DISPLACED),
        "planner, exact simulator": Planner(plans),
    }


def planned(agent: Agent, games: Sequence[str], plans: int) -> dict[str, Any]:
    """Rewards and successes of an agent, at 60 steps a second, in float64 and a fresh space, as JSON values.

    Args:
        agent: gives TRIES plans for each game.
        games: to play.
        plans: that it imagines for each game; written down alone.
    """
    played = attempts(agent, TRIES, games=games, seed=SEED)
    return {
        "games": {
            game: [float(played.reward[at, 0, 0]), float(played.reward[at, 0].max())] for at, game in enumerate(games)
        },
        "reward": [float(played.reward[:, 0, 0].mean()), float(played.reward[:, 0].max(axis=-1).mean())],
        "solved": [float(played.success[:, 0, 0].mean()), float(played.success[:, 0].any(axis=-1).mean())],
        "plans": plans,
        "attempts": TRIES,
        "faults": played.faults,
    }


def planning_bounds(folder: Path, plans: int) -> dict[str, dict[str, Any]]:
    """What `bounding_agents` reach, by name and split; kept in a file of the folder, only what is missing is played.

    Raises:
        ValueError, OSError: one line; the file is damaged or cannot be written.
    """
    rows = read_bounds(folder)
    for name, agent in bounding_agents(plans).items():
        for split in PLANNED:
            if rows.setdefault(name, {}).get(split, {}).get("plans") != plans:
                rows[name][split] = planned(agent, SPLITS[split], plans)
                content = {"schema": SCHEMA, "version": VERSION, "rows": rows, "origin": provenance()}
                replace_json(folder / BOUNDS_FILE, content)
    return rows


def read_bounds(folder: Path) -> dict[str, dict[str, Any]]:
    """What was played so far; nothing if there is no file. Errors as those of `planning_bounds`."""
    file = folder / BOUNDS_FILE
    return dict(read_versioned(file, SCHEMA, (VERSION,))["rows"]) if file.is_file() else {}

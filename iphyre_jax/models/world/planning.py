"""Planning in a world model: what the best imagined plans bring when they are played, beside other planners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from iphyre_jax.attempts.agents import do_nothing, draw_randomly
from iphyre_jax.attempts.planner import REPEATED_PLANS, Planner
from iphyre_jax.attempts.protocol import Agent, attempts
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.world.imagine import WorldImagination, WorldPlanner
from iphyre_jax.models.world.interface import falls_until_contact
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.storage import WorldModel
from iphyre_jax.scenes import SPLITS
from iphyre_jax.scenes.library import PAPER_SPLITS

TRIES: Final = 5  # the first, and the best of so many
SEED: Final = 0  # of the drawn plans, the same ones for each model and each planner
PLANS: Final = 300  # that are drawn for each game; the different ones are imagined
DISPLACED: Final = 2.0  # px


def model_planner(model: WorldModel, plans: int) -> Agent:
    """The agent that imagines in a trained model."""
    return WorldPlanner(WorldImagination(model), plans)


def bounding_agents(plans: int) -> Mapping[str, Agent]:
    """Agents to stand beside the models: some know no physics, some know it all."""
    falling = WorldImagination(WorldModel("falls", WorldConfig(), (), {}), falls_until_contact)
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
        plans: that it draws for each game; written down alone.
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


def planning_bounds(folder: Path, plans: int) -> dict[str, Row]:
    """What `bounding_agents` reach, by name and split; each is kept in a file of the folder.

    Raises:
        ValueError, OSError: one line; a file is damaged, has other settings, or cannot be written.
    """
    settings = {"plans": plans, "attempts": TRIES, "seed": SEED, **REPEATED_PLANS}

    def row(agent: Agent) -> Row:
        return {split: planned(agent, SPLITS[split], plans) for split in PAPER_SPLITS}

    return {
        name: kept_row(folder, name.replace(",", "").replace(" ", "-"), settings, partial(row, agent))
        for name, agent in bounding_agents(plans).items()
    }

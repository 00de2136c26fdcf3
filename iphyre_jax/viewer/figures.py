"""The rewards that the paper reports for every game, for comparison."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import Any

from iphyre_jax.scenes import SPLITS


@cache
def figures() -> dict[str, Any]:
    """Return the contents of figures.json: source, protocol, agents, oracle by split, rewards by game."""
    return json.loads(files(__package__).joinpath("figures.json").read_text("utf-8"))


def split_of(game: str) -> str | None:
    """Return the split of a game of the package; None for other scenes."""
    return next((split for split, games in SPLITS.items() if game in games), None)


def figures_of(game: str) -> dict[str, object]:
    """Return the rewards in the paper: human mean, oracle (mean of the split), agents. Empty for other scenes."""
    table, split = figures(), split_of(game)
    row = table["games"].get(game)
    if row is None:
        return {}
    agents = dict(zip(table["agents"], row["agents"], strict=True))
    return {"human": row["human"], "oracle_split": table["oracle"][split], "split": split, "agents": agents}

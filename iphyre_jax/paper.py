"""The numbers that the paper reports: its tables and what its text says of failures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from iphyre_jax.scenes.library import SPLIT_OF


@cache
def paper_numbers() -> Mapping[str, Any]:
    """Return the contents of paper.json.

    `agents`: name -> split -> [reward, success in %]; `per_game`: game -> name -> reward; `unseen_basic`: name ->
    rewards on both sets of layouts; `classifiers`: accuracies in % by split; `language_model`: rewards by split;
    `failures_by_timing`: in %; `source` and `protocol`: words on the first two, `source_of_the_rest` on the others.
    """
    numbers: Mapping[str, Any] = json.loads(files(__package__).joinpath("paper.json").read_text("utf-8"))
    return numbers


def paper_rewards(game: str) -> dict[str, object]:
    """Return a game's rewards, as the viewer shows them; empty for other scenes.

    `human`: of people; `split` and `oracle_split`: the oracle's mean over that split; `agents`: of each agent.
    """
    numbers = paper_numbers()
    if game not in numbers["per_game"]:
        return {}
    agents, split = dict(numbers["per_game"][game]), SPLIT_OF[game]
    human, oracle = agents.pop("Human"), numbers["agents"]["Oracle"][split][0]
    return {"human": human, "oracle_split": oracle, "split": split, "agents": agents}

"""Tables of shipped scores beside the paper's: the forty games by agent, and unseen layouts of the basic games."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

from iphyre_jax.analyses.figures import COLUMNS, by_split, mean_difference
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.intervals import Estimate, bootstrap
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.train.reports.report import markdown_table, paper_numbers
from iphyre_jax.train.settings.run import STRATEGY_LETTERS

UNSEEN = tuple(SPLITS["unseen_basic"])


@cache
def paper_facts() -> Mapping[str, Any]:
    """The paper's figures beside its table of rewards: unseen basic, outcome classifiers, language model, failures."""
    facts: Mapping[str, Any] = json.loads(files(__package__).joinpath("paper.json").read_text("utf-8"))
    return facts


def paper_name(policy: Policy) -> str:
    """The paper's name of an agent like this policy: "PPO-I"."""
    return f"{str(policy.settings['agent']).upper()}-{STRATEGY_LETTERS[policy.settings['strategy']]}"


def games_document(policies: Sequence[Policy]) -> str:
    """Return the table of the forty games: sampled means of the shipped policies beside the paper's agents."""
    paper = paper_numbers()["per_game"]
    parts = [
        "# Game by game",
        "Written by `iphyre-jax analyse games`. Ours: shipped policies (one seed each), mean of 20 sampled episodes. "
        "Paper: one sampled episode at 10 steps a second, so that a cell is a single draw.",
    ]
    for fps in sorted({policy.fps for policy in policies}):
        chosen = [policy for policy in policies if policy.fps == fps]
        values = {policy.name: policy.values("sampled") for policy in chosen}
        twins = (
            [name for name in dict.fromkeys(map(paper_name, chosen)) if name in paper[GAMES[0]]] if fps == 10 else []
        )
        cells = [
            [
                game,
                *(f"{values[policy.name][game]:.1f}" for policy in chosen),
                *(f"{paper[game][name]:.1f}" for name in twins),
            ]
            for game in GAMES
        ]
        means = [f"{by_split(values[policy.name])['all']:.1f}" for policy in chosen]
        cells.append(["mean", *means, *(f"{sum(paper[g][name] for g in GAMES) / len(GAMES):.1f}" for name in twins)])
        header = ["game", *(policy.name for policy in chosen), *(f"paper {name}" for name in twins)]
        dtype = chosen[0].settings["dtype"]
        parts += [f"## {fps} steps a second, {dtype}", markdown_table(header, cells)]
    return "\n\n".join(parts) + "\n"


def unseen_difference(policy: Policy, kind: str = "greedy") -> Estimate:
    """Return the mean difference of reward, unseen basic minus basic, with its interval over the ten pairs of games."""
    values = policy.values(kind)
    basic = [values[game] for game in COLUMNS["basic"]]
    unseen = [values[f"unseen_{game}"] for game in COLUMNS["basic"]]
    return bootstrap(mean_difference, basic, unseen)


def within_template_document(policies: Sequence[Policy]) -> str:
    """Return the table of basic and unseen basic games."""
    cells = []
    for policy in policies:
        values = policy.values("greedy")
        basic = sum(values[game] for game in COLUMNS["basic"]) / 10
        unseen = sum(values[game] for game in UNSEEN) / 10
        found = unseen_difference(policy)
        change = f"{found.value:.1f} [{found.low:.0f}, {found.high:.0f}]"
        cells.append([policy.name, str(policy.fps), f"{basic:.1f}", f"{unseen:.1f}", change])
    tables = []
    for fps in sorted({policy.fps for policy in policies}):
        rows = [[*cell[:1], *cell[2:]] for cell in cells if cell[1] == str(fps)]
        header = ["policy", "basic", "unseen basic", "difference"]
        tables += [f"## Ours, {fps} steps a second, greedy", markdown_table(header, rows)]
    stated = [
        [name, f"{pair['basic']:.2f}", f"{pair['unseen']:.2f}", f"{pair['unseen'] - pair['basic']:.2f}"]
        for name, pair in paper_facts()["unseen_basic"].items()
    ]
    return (
        "\n\n".join(
            [
                "# Within the template",
                "Written by `iphyre-jax analyse within-template`. Basic games, on which the policies were trained, and "
                "ten other layouts of them. Shipped policies, one seed each; in brackets the 95 % bootstrap interval "
                "over the ten games.",
                *tables,
                "## Paper, 10 steps a second, one episode a game",
                markdown_table(["agent", "basic", "unseen basic", "difference"], stated),
                f"The paper lists {paper_facts()['unseen_basic']['A2C-C']['basic']} for A2C-C on basic here, and "
                f"{paper_numbers()['agents']['A2C-C']['basic'][0]} in its table of the forty games.",
            ]
        )
        + "\n"
    )

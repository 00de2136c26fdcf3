"""Tables of scores beside the paper's: the forty games by shipped policy, and unseen layouts of the basic games."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from iphyre_jax.analyses.figures import by_split
from iphyre_jax.analyses.seeds import GREEDY, unseen_difference
from iphyre_jax.analyses.shipped import Policy
from iphyre_jax.paper import paper_numbers
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.reports.compare import Row
from iphyre_jax.train.reports.report import markdown_table
from iphyre_jax.train.settings.run import STRATEGY_LETTERS


def paper_name(policy: Policy) -> str:
    """The paper's name of an agent like this policy: "PPO-I"."""
    return f"{str(policy.settings['agent']).upper()}-{STRATEGY_LETTERS[policy.settings['strategy']]}"


def games_document(policies: Sequence[Policy]) -> str:
    """Return the table of the forty games: sampled means of the shipped policies beside the paper's agents."""
    paper = paper_numbers()["per_game"]
    parts = [
        "# Game by game",
        "Written by `iphyre-jax analyse games`. Ours: shipped policies, each the best of five seeds on the basic and "
        "unseen basic games, mean of 20 sampled episodes. "
        "Paper: one sampled episode at 10 steps a second, with the checkpoint of the best of five evaluations: a cell "
        "is a single draw, and the choice makes their mean somewhat too high ([Protocols](protocols.md)).",
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


def within_template_document(rows: Mapping[str, Row]) -> str:
    """Return the table of basic and unseen basic games; rows: all seeds of each agent, by its name in the package."""
    tables = []
    for fps in sorted({row.config.fps for row in rows.values()}):
        cells = [[name, str(len(row.seeds)), *_of_seeds(row)] for name, row in rows.items() if row.config.fps == fps]
        header = ["agent", "seeds", "basic", "unseen basic", "difference"]
        tables += [f"## Ours, {fps} steps a second, greedy", markdown_table(header, cells)]
    learned = "Learned from variations of these games or from generated scenes too"
    more = [name for name, row in rows.items() if row.config.variations or row.config.scene_pool]
    stated = [
        [name, f"{pair['basic']:.2f}", f"{pair['unseen']:.2f}", f"{pair['unseen'] - pair['basic']:.2f}"]
        for name, pair in paper_numbers()["unseen_basic"].items()
    ]
    return (
        "\n\n".join(
            [
                "# Within the template",
                "Written by `iphyre-jax analyse within-template`. Basic games, on which the agents were trained, and "
                "ten other layouts of them. Means of the seeds that `make results` trained; in brackets the 95 % t "
                "interval over seeds.",
                *([f"{learned}: {', '.join(more)}."] if more else []),
                *tables,
                "## Paper, 10 steps a second, one episode a game",
                markdown_table(["agent", "basic", "unseen basic", "difference"], stated),
                f"The paper lists {paper_numbers()['unseen_basic']['A2C-C']['basic']} for A2C-C on basic here, and "
                f"{paper_numbers()['agents']['A2C-C']['basic'][0]} in its table of the forty games.",
            ]
        )
        + "\n"
    )


def _of_seeds(row: Row) -> list[str]:
    """Greedy reward of basic and unseen basic games, and the difference."""
    found = row.summary(GREEDY, "basic"), row.summary(GREEDY, "unseen_basic"), unseen_difference(row)
    return [f"{of.mean:.1f} {of.estimate.bounds()}" if of else "-" for of in found]

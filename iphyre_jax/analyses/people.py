"""People of the paper: 46 of them, best of five attempts at 60 steps a second; only means are published.

The share of people who solved a game is derived: a score is taken as a mixture of the best plan and of a typical
failure, three or four removals and 15 s.
"""

from __future__ import annotations

from typing import Final

from iphyre_jax.analyses.figures import COLUMNS, by_split
from iphyre_jax.analyses.oracle import shipped
from iphyre_jax.paper import paper_numbers
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import GAMES
from iphyre_jax.scenes.library import SPLIT_OF
from iphyre_jax.train.reports.report import TITLES, markdown_table

FAILURE: Final = -40.0  # points of a typical failure


def scores() -> dict[str, float]:
    """Return the mean score of people in each game, as the paper states it."""
    return {game: float(paper_numbers()["per_game"][game]["Human"]) for game in GAMES}


def success_rates() -> dict[str, float]:
    """Return the derived share of people who solved each game: (H + 40) / (R + 40), R the best reward known."""
    best = shipped(PEOPLE_FPS)
    return {game: (score - FAILURE) / (best[game]["reward"] - FAILURE) for game, score in scores().items()}


def document() -> str:
    """Return the document about people."""
    rates, points = success_rates(), scores()
    derived, stated = by_split(rates), paper_numbers()["agents"]["Human"]
    splits = [
        [TITLES[split], f"{stated[split][0]:.2f}", f"{stated[split][1]:.2f}", f"{100 * derived[split]:.1f}"]
        for split in COLUMNS
    ]
    hardest = sorted(GAMES, key=lambda game: rates[game])
    games = [[game, TITLES[SPLIT_OF[game]], f"{points[game]:.1f}", f"{100 * rates[game]:.1f}"] for game in hardest]
    return (
        "\n\n".join(
            [
                "# People",
                "Written by `iphyre-jax analyse people`. Scores: the paper's, 46 people, best of five attempts at 60 "
                "steps a second. Solved, derived: (score + 40) / (best reward known + 40), good to one or two points.",
                markdown_table(["split", "score", "solved %, stated", "solved %, derived"], splits),
                "## By game, hardest first",
                markdown_table(["game", "split", "score", "solved %, derived"], games),
            ]
        )
        + "\n"
    )

"""The document of imagination: first try and best of five, the curves, and the comparison with people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses import people
from iphyre_jax.analyses.figures import COLUMNS, by_split, spearman
from iphyre_jax.analyses.imagination.choice import SOLVED, TRIES, TRUST, best_after
from iphyre_jax.analyses.imagination.imagined import (
    COPIES,
    FROM_POLICY,
    POLICY,
    Imagination,
    RealRewards,
    imagined,
    real,
)
from iphyre_jax.analyses.imagination.people_model import HALVES, Fit, Test, fit
from iphyre_jax.analyses.shipped import policies
from iphyre_jax.intervals import mean_interval
from iphyre_jax.paper import paper_numbers
from iphyre_jax.rules import PEOPLE_FPS
from iphyre_jax.scenes import GAMES
from iphyre_jax.train.reports.report import TITLES, markdown_table

HEADLINE: Final = Imagination(2.0, draws=10)
WITH_POLICY: Final = Imagination(2.0, proposals="policy")
SLOW: Final = (Imagination(0.0, fps=10), Imagination(2.0, fps=10))
BY_SIGMA: Final = (*(Imagination(s) for s in (0.0, 1.0)), HEADLINE, *(Imagination(s) for s in (5.0, 10.0, 20.0, 40.0)))
ALL: Final = (*BY_SIGMA, WITH_POLICY, *SLOW)
COUNTS: Final = (5, 20, 100, 300)  # drawn plans, of which the different ones are imagined
USUAL: Final = 100
BELIEVED: Final = (1, 3, COPIES)  # displaced scenes

Floats = npt.NDArray[np.float64]


def compute(folder: Path, game: str) -> None:
    """Compute the rows of a game that are missing."""
    for how in ALL:
        imagined(folder, game, how)
        _real(folder, game, how)


def is_whole(folder: Path) -> bool:
    """Return whether a folder has all rows."""
    kept = {how.name for how in ALL} | {f"played-{how.proposals}" for how in ALL}
    return all((folder / name / f"{game}.json").is_file() for name in kept for game in GAMES)


def _real(folder: Path, game: str, how: Imagination) -> RealRewards:
    return real(folder, game, how.proposals, HEADLINE.draws if how.proposals == "random" else how.draws)


def _scores(
    folder: Path, how: Imagination, plans: int, learning: bool = False, copies: int = COPIES
) -> dict[str, Floats]:
    """Mean over draws of the best reward after 1, ..., TRIES attempts, and of success, (2, TRIES), game by game."""
    found = {}
    for game in GAMES:
        believed = imagined(folder, game, how)[:, :copies]
        best = best_after(believed, _real(folder, game, how), plans, learning)
        found[game] = np.stack([best.mean(axis=0), (best > SOLVED).mean(axis=0)])
    return found


def _of(scores: Mapping[str, Floats], attempts: int, row: int = 0) -> dict[str, float]:
    return {game: float(found[row, attempts - 1]) for game, found in scores.items()}


def document(folder: Path) -> str:
    """Return the document of the rows in a folder, once all are there.

    Raises:
        ValueError: a row has other settings; one line.
    """
    rates = {game: float((_real(folder, game, HEADLINE).reward > SOLVED).mean()) for game in GAMES}
    planners = {(how.sigma, plans): _of(_scores(folder, how, plans), TRIES) for how in BY_SIGMA for plans in COUNTS}
    compared = fit(people.scores(), planners, rates)
    return "\n\n".join(
        [
            "# Imagination",
            "Written by `iphyre-jax analyse imagination`. The planner imagines plans in simulators whose objects are "
            f"displaced by N(0, sigma) px, {COPIES} of them, and tries the plan with the best mean reward, then the "
            f"next, up to {TRIES} times, none twice. The world has {PEOPLE_FPS} steps a second, in a fresh space, as "
            "people play. This is not zero shot: the planner has the equations of motion. In brackets: 95 % bootstrap "
            "interval over games. *Learning*: a simulator that foretold another outcome of an attempt keeps "
            f"{TRUST:g} of its weight. Proposals are official random plans; *policy*: {100 * FROM_POLICY:.0f} % of "
            f"them are sampled from `{POLICY}`. The number of copies and the rule were chosen on generated scenes, "
            "none of them of the benchmark; nothing was chosen here.",
            f"## {HEADLINE.sigma:g} px, {USUAL} plans, {HEADLINE.draws} draws",
            _headline(folder),
            f"## By number of displaced scenes, {HEADLINE.sigma:g} px, {USUAL} plans, all forty games",
            _by_copies(folder),
            f"## By number of plans, all forty games: first try / best of {TRIES}",
            _curves(folder),
            "## People",
            _people(compared, planners, rates) + "\n",
        ]
    )


def _headline(folder: Path) -> str:
    cells = []
    for title, how, learning in (
        ("planner", HEADLINE, False),
        ("planner, learning", HEADLINE, True),
        (f"planner, policy proposes ({WITH_POLICY.draws} draws)", WITH_POLICY, False),
        (f"planner that knows all exactly ({BY_SIGMA[0].draws} draws)", BY_SIGMA[0], False),
    ):
        scores = _scores(folder, how, USUAL, learning)
        for attempts in (1, TRIES):
            reward, solved = _of(scores, attempts), _of(scores, attempts, 1)
            shown = [
                f"{_interval(reward, games)} {100 * np.mean([solved[game] for game in games]):.0f}%"
                for games in COLUMNS.values()
            ]
            cells.append([title, str(attempts), *shown])
    random = {game: _real(folder, game, HEADLINE).reward[:, :TRIES] for game in GAMES}
    for attempts in (1, TRIES):
        best = {game: float(ends[:, :attempts].max(axis=1).mean()) for game, ends in random.items()}
        solved = {game: float((ends[:, :attempts] > SOLVED).any(axis=1).mean()) for game, ends in random.items()}
        cells.append(
            [
                "random plans",
                str(attempts),
                *(
                    f"{_interval(best, games)} {100 * np.mean([solved[game] for game in games]):.0f}%"
                    for games in COLUMNS.values()
                ),
            ]
        )
    stated = paper_numbers()["agents"]["Human"]
    cells.append(
        ["people (paper)", str(TRIES), *(f"{stated[split][0]:.1f} {stated[split][1]:.0f}%" for split in COLUMNS)]
    )
    return markdown_table(["agent", "attempts", *(TITLES[split] for split in COLUMNS)], cells)


def _interval(values: Mapping[str, float], games: Sequence[str]) -> str:
    found = mean_interval([values[game] for game in games])
    return f"{found.value:.1f} {found.bounds()}"


def _by_copies(folder: Path) -> str:
    cells = []
    for copies in BELIEVED:
        scores = _scores(folder, HEADLINE, USUAL, copies=copies)
        cells.append([str(copies), *(_interval(_of(scores, k), GAMES) for k in (1, TRIES))])
    return markdown_table(["displaced scenes", "first try", f"best of {TRIES}"], cells)


def _curves(folder: Path) -> str:
    cells = []
    for how in ALL:
        shown = []
        for plans in COUNTS:
            scores = _scores(folder, how, plans)
            shown.append(" / ".join(f"{by_split(_of(scores, k))['all']:.0f}" for k in (1, TRIES)))
        cells.append([f"{how.sigma:g}", str(how.fps), how.proposals, str(how.draws), *shown])
    header = ["sigma, px", "imagined steps a second", "proposals", "draws", *(f"{n} plans" for n in COUNTS)]
    return markdown_table(header, cells)


def _people(
    compared: Fit, planners: Mapping[tuple[float, int], Mapping[str, float]], rates: Mapping[str, float]
) -> str:
    wanted = people.scores()
    often = sorted(compared.chosen.items(), key=lambda entry: -entry[1])
    best = often[0][0]
    verdict = "better" if compared.better_rank > 0.5 and compared.better_error > 0.5 else "no better"
    correlations = [
        ["share of random plans that solve", _rank(rates, wanted)],
        *(
            [f"planner, {s:g} px, {n} plans, best of {TRIES}", _rank(scores, wanted)]
            for (s, n), scores in planners.items()
            if n == best[1]
        ),
        *(
            [f"{policy.name}, sampled, {policy.fps} fps", _rank(policy.values("sampled"), wanted)]
            for policy in policies()
        ),
    ]
    games = sorted(GAMES, key=lambda game: wanted[game])
    return "\n\n".join(
        [
            "Sigma and the number of plans are fitted to people's scores in half of the games of each split, and "
            f"tested on the other half, {HALVES} times. In brackets: the range of 95 % of the halves. They share "
            "games, so this is no test of significance.",
            markdown_table(
                ["foretells people's scores", "Spearman, games not fitted to", "error, points"],
                [
                    ["planner, fitted", *_test(compared.planner)],
                    ["line through the share of random plans", *_test(compared.rival)],
                ],
            ),
            f"The planner has the higher correlation in {100 * compared.better_rank:.0f} % of the halves and the "
            f"smaller error in {100 * compared.better_error:.0f} %: it foretells people **{verdict}** than the share "
            "of random plans that solve a game. Fitted most often: "
            + ", ".join(f"{s:g} px with {n} plans ({count} of {HALVES})" for (s, n), count in often[:3])
            + ".",
            "### Correlation with people over the forty games (Spearman)",
            "In sample: the number of plans is that of the pair that was fitted most often to these scores, so the "
            "highest of the planners is flattered; the test is the table above. Policies of 10 steps a second stand "
            "here only for the order of the games.",
            markdown_table(["scores of", "correlation"], correlations),
            f"### Game by game, hardest for people first; planner with {best[0]:g} px and {best[1]} plans",
            markdown_table(
                ["game", "people", "planner", "random plans that solve, %"],
                [
                    [game, f"{wanted[game]:.1f}", f"{planners[best][game]:.1f}", f"{100 * rates[game]:.1f}"]
                    for game in games
                ],
            ),
        ]
    )


def _rank(values: Mapping[str, float], wanted: Mapping[str, float]) -> str:
    return f"{float(spearman([values[game] for game in GAMES], [wanted[game] for game in GAMES])):.2f}"


def _test(test: Test) -> tuple[str, str]:
    return str(test.rank), f"{test.error.value:.0f} {test.error.bounds()}"

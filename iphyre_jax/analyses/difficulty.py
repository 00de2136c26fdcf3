"""Difficulty of a game: how many random plans of the official distribution it takes until 50 solve it.

The official data sets wait for 50 plans that do not solve it too; both counts are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.analyses.figures import COLUMNS, share, spearman
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.analyses.people import scores as scores_of_people
from iphyre_jax.analyses.search import play_plans_of
from iphyre_jax.data.draws import random_plans
from iphyre_jax.intervals import Estimate, bootstrap
from iphyre_jax.kept_rows import Row, kept_row, rows_there
from iphyre_jax.paper import paper_numbers
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import GAMES, load_scene
from iphyre_jax.train.reports.report import TITLES, markdown_table

WANTED: Final = 50  # of each kind
CAP: Final = 20_000  # plans
BATCH: Final = 512
DTYPE: Final = "float64"  # in float32 the narrowest games count otherwise


def settings(fps: int, seed: int) -> dict[str, Any]:
    """Return what decides a row."""
    return {"fps": fps, "resets": RESETS[fps], "dtype": DTYPE, "seed": seed, "cap": CAP, "wanted": WANTED}


def measure(game: str, fps: int, seed: int) -> Row:
    """Draw and play plans until both kinds are complete or the cap is reached; return counts as JSON values.

    "to_successes" and "to_failures" are the draws until the 50th of a kind, None if the cap came first; "plays" and
    "solved" count all that were played, whole batches.
    """
    scene = load_scene(game)
    blocks, drawn = len(scene.eliminable_blocks), random_plans(scene, "official", seed)
    success = np.zeros(0, bool)
    while len(success) < CAP and min(success.sum(), (~success).sum()) < WANTED:
        plans = list(islice(drawn, min(BATCH, CAP - len(success))))
        if not plans:
            break
        steps = plan_to_steps(np.array(plans)[:, :blocks], fps, "simulate")
        success = np.append(success, play_plans_of(scene, steps, fps, RESETS[fps], DTYPE)[1])
    return {
        "game": game,
        "to_successes": _until(success),
        "to_failures": _until(~success),
        "plays": len(success),
        "solved": int(success.sum()),
    }


def _until(hits: np.ndarray[Any, np.dtype[np.bool_]]) -> int | None:
    """The number of draws until the 50th hit."""
    found = np.flatnonzero(hits)
    return int(found[WANTED - 1]) + 1 if len(found) >= WANTED else None


def run(folder: Path, fps: int, seed: int, games: Sequence[str] = GAMES) -> dict[str, Row]:
    """Return the rows of games, measuring those that are missing in `folder`/difficulty-<fps>fps-<seed>."""
    kept = folder / f"difficulty-{fps}fps-{seed}"
    return {game: kept_row(kept, game, settings(fps, seed), partial(measure, game, fps, seed)) for game in games}


def rows_there_of(folder: Path, fps: int, seed: int) -> dict[str, Row]:
    """Return the rows of the forty games that are in the folder; errors as of `rows_there`."""
    return rows_there(folder / f"difficulty-{fps}fps-{seed}", dict.fromkeys(GAMES, settings(fps, seed)))


def iterations(row: Row) -> int:
    """Return the draws until 50 successes; the cap if there were fewer."""
    found = row["to_successes"]
    return CAP if found is None else int(found)


def official_iterations(row: Row) -> int:
    """Return the draws until 50 successes and 50 failures; the cap if there were fewer."""
    return CAP if row["to_failures"] is None else max(iterations(row), int(row["to_failures"]))


def success_rates(seeds: Sequence[Mapping[str, Row]]) -> dict[str, tuple[int, int]]:
    """Return solved plays and plays of each game, over all seeds."""
    return {game: (sum(s[game]["solved"] for s in seeds), sum(s[game]["plays"] for s in seeds)) for game in seeds[0]}


def agreement(rows: Mapping[str, Row], games: Sequence[str] = GAMES) -> Estimate:
    """Return the rank correlation of iterations with people's scores, with its interval over games."""
    people = scores_of_people()
    return bootstrap(spearman, [iterations(rows[game]) for game in games], [people[game] for game in games])


def solvers(game: str) -> int:
    """Return how many of the paper's eleven agents that learn solve a game."""
    scores = paper_numbers()["per_game"][game]
    return sum(value > 0 for name, value in scores.items() if name not in ("Human", "Random"))


def document(rates: Mapping[int, Sequence[Mapping[str, Row]]]) -> str:
    """Return the document: the seeds of each rate; seeds of which games are missing are left out, and named."""
    parts = [
        "# Difficulty",
        f"Written by `iphyre-jax analyse difficulty`. Random plans of the official distribution (streams of seed 0, 1, "
        f"...) until {WANTED} solve the game; cap {CAP:,}. The official data sets also wait for {WANTED} that do not: "
        "column `both`. Every plan is played in the same reset, where the official loop resets one space again and "
        "again: some 0.4 % of plans end otherwise. Solved: share of all plays, with its 95 % Wilson interval.",
    ]
    for fps, seeds in rates.items():
        whole = {seed: rows for seed, rows in enumerate(seeds) if set(GAMES) <= set(rows)}
        missing = [f"seed {seed}" for seed in range(len(seeds)) if seed not in whole]
        parts.append(f"## {fps} steps a second, reset {RESETS[fps]}, {DTYPE}")
        if missing:
            parts.append(f"Still missing, in whole or in part: {', '.join(missing)}.")
        if whole:
            parts += [_split_table(whole), _game_table(whole)]
    return "\n\n".join(parts) + "\n"


def _split_table(whole: Mapping[int, Mapping[str, Row]]) -> str:
    """Geometric mean of the iterations by split, and agreement with people and with the paper's agents; by seed."""
    seeds, cells = list(whole.values()), []
    for split, games in COLUMNS.items():
        of_split = [rows[game] for rows in seeds for game in games]
        logs = [np.log(iterations(row)) for row in of_split]
        people = agreement(seeds[0], games)
        agents = spearman([iterations(seeds[0][game]) for game in games], [solvers(game) for game in games])
        cells.append([TITLES[split], _counted(float(np.exp(np.mean(logs))), of_split), str(people), f"{agents:.2f}"])
    people_title = f"Spearman with people, seed {next(iter(whole))}"
    header = ["split", f"iterations, geometric mean of {len(seeds)} seeds", people_title, "with agents that solve it"]
    return markdown_table(header, cells)


def _counted(number: float, rows: Sequence[Row], kinds: Sequence[str] = ("to_successes",)) -> str:
    """A number of draws; "over" if the cap ended one of the counts that it is made of."""
    return f"{'over ' if any(row[kind] is None for row in rows for kind in kinds) else ''}{number:,.0f}"


def _game_table(whole: Mapping[int, Mapping[str, Row]]) -> str:
    """One line a game, hardest first; by seed."""
    first, seeds = next(iter(whole)), list(whole.values())
    rates, cells = success_rates(seeds), []
    for game in sorted(GAMES, key=lambda game: -iterations(seeds[0][game])):
        found = share(*rates[game])
        of_game = [rows[game] for rows in seeds]
        cells.append(
            [
                game,
                _counted(iterations(of_game[0]), of_game[:1]),
                _counted(official_iterations(of_game[0]), of_game[:1], ("to_successes", "to_failures")),
                _counted(float(np.mean([iterations(row) for row in of_game])), of_game),
                f"{100 * found.value:.2f} [{100 * found.low:.2f}, {100 * found.high:.2f}]",
            ]
        )
    header = ["game", f"seed {first}", f"both, seed {first}", f"mean of {len(seeds)} seeds", "solved %"]
    return markdown_table(header, cells)

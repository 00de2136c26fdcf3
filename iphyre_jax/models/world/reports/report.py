"""docs/results/world.md from the evaluations of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from iphyre_jax.files import replace_text
from iphyre_jax.kept_rows import Row
from iphyre_jax.models.world.planning import SEED, TRIES
from iphyre_jax.models.world.reports.metrics import CERTAIN, COLUMNS, COUNTED, HORIZONS
from iphyre_jax.provenance import made_by
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.report import markdown_table, seeds_cell

TITLES: Final = {
    "basic": "basic, other plans",
    "unseen_basic": "unseen basic",
    "noisy": "noisy",
    "compositional": "compositional",
    "multi_ball": "multi-ball",
}
FREQUENT: Final = f"always the more frequent outcome of {COUNTED} other plays of each game"
ABOUT: Final = """# World models

Written by `make results-world`; do not edit. What will the scene look like 0.1 s later, and how does a plan end
that is only imagined?

* Plays: 60 steps a second, rule "simulate", fresh space (reset 1), random plans of the official distribution. Learned
  from: basic games, and variations of them for "unlimited". The plays judged here are others; but random plans of games
  with two blocks repeat, so a few plays of basic games were learned from too.
* The seed of `objects-unlimited` with most outcomes right in unseen basic ships with the package.
* `objects` is ours; the number behind it counts its plays. `mdrnn` is the paper's with repairs
  (`networks/mdrnn.py`), from 1,000 plays of basic games: compare it with `objects-1000`. The number behind it counts
  gradient steps. Its sigma is never below 6 px, so smaller errors hardly counted in its training.
* Errors are medians over balls, px, that move faster than 5 px/s within the picture when the prediction begins: 300
  moments a column. Those whose play ends sooner drop out, at 6 s a third to two fifths, so a line is no curve.
* `objects` and free fall are given the velocities of that moment. `mdrnn` sees places alone, those of the 3.2 s before
  too: it learned from windows of 6.4 s, at the start of which it remembers nothing. The bound that
  moves on sees places alone too, two of them; it knows neither gravity nor contact.
* Imagined outcomes and plans begin at rest. Outcomes are of 10 plays of each game, 100 in a column: differences under
  some 8 points can be chance. The last row knows how other plays of the same game end; no model does.
* Plays are judged in float32, planned attempts in float64. Planners try no plan twice. Where no plan solves a game in a
  model, its planner tries those that remove fewest blocks: worse than random plans.
* Mean over seeds ± standard deviation; a row without ± has one seed.
* `models/world/`, beside this page, has settings, log and scores of each row.
"""

Evaluations = Mapping[str, Sequence[Mapping[str, Any]]]


class Bounds(NamedTuple):
    """What needs no model, by split."""

    errors: Row  # as `error_bounds` gives them
    frequent: Row  # share of plans that end as most other plays of their game
    planning: Mapping[str, Row]  # other planners, as `planning_bounds` gives them


def _columns(runs: Sequence[Mapping[str, Any]], column: str) -> list[Mapping[str, Any]]:
    return [run["columns"][column] for run in runs if column in run["columns"]]


def horizon_table(evaluations: Evaluations, column: str, bounds: Mapping[str, Sequence[float]]) -> str:
    """Median errors by horizon, of models and of bounds."""
    rows = []
    for name, runs in evaluations.items():
        errors = [found["median error px"] for found in _columns(runs, column)]
        rows.append([name, *(seeds_cell([one["model"][k] for one in errors], digits=2) for k in range(len(HORIZONS)))])
    rows += [[name, *(f"{value:.2f}" for value in errors)] for name, errors in bounds.items()]
    return markdown_table(["row", *(f"{horizon / 10:g} s" for horizon in HORIZONS)], rows)


def outcome_table(evaluations: Evaluations, frequent: Mapping[str, float]) -> str:
    """Shares of plans whose outcome is imagined rightly, by split; frequent: see `frequent_outcomes`."""
    rows = []
    for name, runs in evaluations.items():
        shares = [[found["outcomes"]["right"] for found in _columns(runs, column)] for column in COLUMNS]
        rows.append([name, *(seeds_cell(values, 100) for values in shares)])
    rows.append([FREQUENT, *(f"{100 * frequent[column]:.1f}" for column in COLUMNS)])
    return markdown_table(["row", *(TITLES[column] for column in COLUMNS)], rows)


def calibration_table(evaluations: Evaluations) -> str:
    """Shares of true places within one and two sigma, and of those that are uncertain."""
    rows = []
    for name, runs in evaluations.items():
        cells = []
        for column in COLUMNS:
            found = [each["calibration"] for each in _columns(runs, column) if "calibration" in each]
            keys = ("one sigma", "two sigma", "uncertain")
            shares = [seeds_cell([one[key] for one in found if key in one], 100, 0) for key in keys]
            cells.append(f"{shares[0]} / {shares[1]} of {shares[2]}" if found else "-")
        if any(each != "-" for each in cells):
            rows.append([name, *cells])
    return markdown_table(["row", *(TITLES[column] for column in COLUMNS)], rows)


def planning_table(evaluations: Evaluations, bounds: Mapping[str, Mapping[str, Any]]) -> str:
    """Reward and share solved at the first attempt and by the best of TRIES."""
    played = {name: [run["planning"] for run in runs if run.get("planning")] for name, runs in evaluations.items()}
    rows = []
    for name, plans in {**played, **{name: [found] for name, found in bounds.items()}}.items():
        for attempt, title in enumerate(("first", f"best of {TRIES}")):
            whole = [plan for plan in plans if all(split in plan for split in PAPER_SPLITS)]
            cells = [_played([[plan[split]] for plan in plans if split in plan], attempt) for split in PAPER_SPLITS]
            cells.append(_played([[plan[split] for split in PAPER_SPLITS] for plan in whole], attempt))
            if plans:
                rows.append([f"{name}, {title}", *cells])
    return markdown_table(["row", *(TITLES[split].split(",")[0] for split in PAPER_SPLITS), "all forty"], rows)


def _played(seeds: Sequence[Sequence[Mapping[str, Any]]], attempt: int) -> str:
    """Reward and games solved: of each seed the mean over splits of as many games."""
    if not seeds:
        return "-"
    reward, solved = (
        [float(np.mean([split[key][attempt] for split in splits])) for splits in seeds] for key in ("reward", "solved")
    )
    return f"{seeds_cell(reward, digits=0)} / {seeds_cell(solved, 100, 0)} %"


def runs_table(evaluations: Evaluations) -> str:
    """What each row learned from."""
    rows = []
    for name, runs in evaluations.items():
        seeds = " ".join(str(run["settings"]["seed"]) for run in runs)
        settings = runs[0]["settings"]
        rows.append([name, seeds, settings["data"], str(runs[0]["steps"]), str(settings["batch_size"])])
    return markdown_table(["row", "seeds", "plays", "gradient steps", "windows in a step"], rows)


def write(
    out: Path,
    evaluations: Evaluations,
    bounds: Bounds,
    missing: Sequence[str],
    facts: Mapping[str, Any],
) -> None:
    """Write the document.

    Args:
        out: of the document.
        evaluations: of each seed, by row, in the order shown.
        bounds: what needs no model.
        missing: runs that are not there.
        facts: provenance, JSON values.
    """
    parts = [ABOUT, "## Runs", runs_table(evaluations)]
    if missing:
        parts.append(f"Missing: {', '.join(missing)}.")
    for column in COLUMNS:
        if any(_columns(runs, column) for runs in evaluations.values()):
            parts += [
                f"## Error of balls, {TITLES[column]}, px",
                horizon_table(evaluations, column, bounds.errors[column]),
            ]
    parts += ["## Outcomes imagined rightly, %", outcome_table(evaluations, bounds.frequent)]
    if any("calibration" in each for runs in evaluations.values() for c in COLUMNS for each in _columns(runs, c)):
        parts += [
            "## Calibration",
            f"Of the coordinates of balls after 0.1 s whose sigma exceeds {CERTAIN:g} px, how many lie within one and "
            "within two sigma, %; the third number says how many % of all these are. 68 % within one if sigma were "
            "right. Errors have heavier tails than a Gaussian.",
            calibration_table(evaluations),
        ]
    planning = [split for runs in evaluations.values() for run in runs for split in run.get("planning", {}).values()]
    if planning:
        parts += [
            "## Planning in the model",
            f"{planning[0]['plans']} random plans of seed {SEED}, the same for all rows, are drawn, and the different "
            "ones imagined; the best are played: reward / games solved. The exact simulator bounds what any model can "
            "reach with these plans. All have the same one draw of plans: ± is over models alone, and a game is 10 % "
            "of a column.",
            planning_table(evaluations, bounds.planning),
        ]
    parts.append(made_by(facts))
    replace_text(out, "\n\n".join(part.strip() for part in parts) + "\n")

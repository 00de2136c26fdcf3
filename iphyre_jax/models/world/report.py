"""docs/results/world.md from the evaluations of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.files import replace_text
from iphyre_jax.models.world.metrics import BOUNDS, COLUMNS, HORIZONS
from iphyre_jax.train.reports.report import markdown_table

TITLES: Final = {
    "basic": "basic, other plans",
    "unseen_basic": "unseen basic",
    "noisy": "noisy",
    "compositional": "compositional",
    "multi_ball": "multi-ball",
}
PLANNED: Final = ("basic", "noisy", "compositional", "multi_ball")
ABOUT: Final = """# World models

Written by `iphyre-jax world evaluate`; do not edit. What will the scene look like 0.1 s later, and how does a plan end
that is only imagined?

* Plays: 60 steps a second, rule "simulate", fresh space (reset 1), random plans of the official distribution. Learned
  from: basic games, and variations of them for "unlimited". The plans judged here were not learned from.
* `objects` is ours; `mdrnn` is the paper's with four repairs; the number behind it counts its gradient steps, that
  behind `objects` its plays.
* Errors are medians over balls, px, from moments at which a ball moves faster than 5 px/s. Plays are judged in float32,
  planned attempts in float64.
* Mean over seeds ± standard deviation; a row without ± has one seed. Random plans solve about 25 % of all games.
"""

Evaluations = Mapping[str, Sequence[Mapping[str, Any]]]


def cell(values: Sequence[float], factor: float = 1.0, digits: int = 1) -> str:
    """Mean and spread over seeds; "-" if there are none."""
    if not values or not np.isfinite(values).all():
        return "-"
    mean = f"{factor * np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {factor * np.std(values):.{digits}f}"


def _columns(runs: Sequence[Mapping[str, Any]], column: str) -> list[Mapping[str, Any]]:
    return [run["columns"][column] for run in runs if column in run["columns"]]


def horizon_table(evaluations: Evaluations, column: str) -> str:
    """Median errors by horizon, with the two bounds."""
    rows = []
    for name, runs in evaluations.items():
        errors = [found["median error px"] for found in _columns(runs, column)]
        rows.append([name, *(cell([one["model"][k] for one in errors], digits=2) for k in range(len(HORIZONS)))])
    some = [found for runs in evaluations.values() for found in _columns(runs, column)][:1]
    for bound in BOUNDS if some else ():
        rows.append([bound, *(f"{value:.2f}" for value in some[0]["median error px"][bound])])
    return markdown_table(["row", *(f"{horizon / 10:g} s" for horizon in HORIZONS)], rows)


def outcome_table(evaluations: Evaluations) -> str:
    """Shares of plans whose outcome is imagined rightly, by split."""
    rows = []
    for name, runs in evaluations.items():
        shares = [[found["outcomes"]["right"] for found in _columns(runs, column)] for column in COLUMNS]
        rows.append([name, *(cell(values, 100) for values in shares)])
    frequent = []
    for column in COLUMNS:
        found = [each for runs in evaluations.values() for each in _columns(runs, column)][:1]
        frequent.append(cell([each["outcomes"]["more frequent outcome of each game"] for each in found], 100))
    rows.append(["always the more frequent outcome of each game", *frequent])
    return markdown_table(["row", *(TITLES[column] for column in COLUMNS)], rows)


def calibration_table(evaluations: Evaluations) -> str:
    """Shares of true places within one and two sigma."""
    rows = []
    for name, runs in evaluations.items():
        cells = []
        for column in COLUMNS:
            found = [each["calibration"] for each in _columns(runs, column) if "calibration" in each]
            cells.append(" / ".join(cell([one[key] for one in found], 100, 0) for key in ("one sigma", "two sigma")))
        if any(each != "- / -" for each in cells):
            rows.append([name, *cells])
    return markdown_table(["row", *(TITLES[column] for column in COLUMNS)], rows)


def planning_table(evaluations: Evaluations) -> str:
    """Reward and share solved at the first attempt and by the best of five."""
    rows = []
    for name, runs in evaluations.items():
        plans = [run["planning"] for run in runs if run.get("planning")]
        for attempt, title in enumerate(("first", "best of 5")):
            cells = []
            for split in PLANNED:
                found = [plan[split] for plan in plans if split in plan]
                reward, solved = ([one[key][attempt] for one in found] for key in ("reward", "solved"))
                cells.append(f"{cell(reward, digits=0)} / {cell(solved, 100, 0)} %" if found else "-")
            whole = [plan for plan in plans if all(split in plan for split in PLANNED)]
            means = [np.mean([plan[split]["reward"][attempt] for split in PLANNED]) for plan in whole]
            shares = [np.mean([plan[split]["solved"][attempt] for split in PLANNED]) for plan in whole]
            cells.append(f"{cell(means, digits=0)} / {cell(shares, 100, 0)} %" if whole else "-")
            if plans:
                rows.append([f"{name}, {title}", *cells])
    return markdown_table(["row", *(TITLES[split].split(",")[0] for split in PLANNED), "all forty"], rows)


def runs_table(evaluations: Evaluations) -> str:
    """Seeds and gradient steps of each row."""
    rows = []
    for name, runs in evaluations.items():
        seeds = " ".join(str(run["settings"]["seed"]) for run in runs)
        steps = " ".join(f"{run['steps']}/{run['settings']['steps']}" for run in runs)
        rows.append([name, seeds, steps])
    return markdown_table(["row", "seeds", "gradient steps made / asked for"], rows)


def write(out: Path, evaluations: Evaluations, facts: Mapping[str, Any]) -> None:
    """Write the document.

    Args:
        out: of the document.
        evaluations: of each seed, by row, in the order shown.
        facts: provenance, JSON values.
    """
    parts = [ABOUT, "## Runs", runs_table(evaluations)]
    for column in COLUMNS:
        if any(_columns(runs, column) for runs in evaluations.values()):
            parts += [f"## Error of balls, {TITLES[column]}, px", horizon_table(evaluations, column)]
    parts += ["## Outcomes imagined rightly, %", outcome_table(evaluations)]
    if any("calibration" in each for runs in evaluations.values() for c in COLUMNS for each in _columns(runs, c)):
        parts += [
            "## Calibration",
            "True places of balls after 0.1 s within one and two sigma, %; 68 and 95 if sigma were right.",
            calibration_table(evaluations),
        ]
    if any(run.get("planning") for runs in evaluations.values() for run in runs):
        parts += [
            "## Planning in the model",
            "Random plans are imagined, the best are played: reward / games solved. With the exact simulator 300 "
            "imagined plans would give the best that any model can.",
            planning_table(evaluations),
        ]
    parts += ["## Made by", "\n".join(f"* {name}: {value}" for name, value in facts.items())]
    replace_text(out, "\n\n".join(part.strip() for part in parts) + "\n")

"""docs/results/outcome.md from the evaluations of the rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.files import replace_text
from iphyre_jax.models.outcome.plays.sets import COLUMNS, GENERATED, HELD, TESTED, TRAINED, VARIED
from iphyre_jax.provenance import made_by
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.report import markdown_table, seeds_cell

TITLES: Final = {
    TRAINED: "learned plays",
    HELD: "basic, other plans",
    VARIED: "variations, other scenes",
    GENERATED: "generated, other scenes",
    "unseen_basic": "unseen basic",
    "noisy": "noisy",
    "compositional": "compositional",
    "multi_ball": "multi-ball",
}
COLOURS: Final = 10  # of matplotlib's cycle, which then begins again
# Accuracy, %, of the paper's single run of each, on the plays that it learned from and on its three test splits.
PAPER: Final = {
    "paper: Global Fusion": (87.5, 59.8, 57.0, 56.7),
    "paper: Object Fusion": (71.4, 60.1, 60.2, 54.1),
    "paper: Vision Fusion": (86.4, 57.5, 55.8, 59.5),
}
MEASURES: Final = {
    "accuracy": "accuracy %",
    "balanced": "balanced %",
    "recall_solved": "recall S %",
    "recall_failed": "recall F %",
    "auroc": "AUROC in a game",
    "brier": "Brier",
}
ABOUT: Final = """# Outcome classifiers

Written by `make results-offline`; do not edit. Will this plan solve this scene? Each row judges plays that it did not
learn from, unless the column says so.

* Plays: 60 steps a second, rule "simulate", fresh space (reset 1), float64; plans of the official distribution; 50 that
  solve and 50 that fail of each game, as in the paper; "basic, other plans" without those that were learned from:
  games of two blocks repeat themselves. Noisy, compositional and multi-ball are never used to choose.
* `paper` is the paper's training exactly, also what is odd in it: "basic" is what was learned, times after the end of a
  play are left out (which tells of the outcome), the rate swings. `clean` is the same networks without that. Vision is
  a small network trained from scratch on our pictures: the paper's needs weights from elsewhere.
* `relations` is ours. It learns up to 1,000 + 1,000 plans of each basic game, plans of variations of the basic games
  with added blocks, and plans of generated scenes, which are near no test game. A quarter of its draws are of the ten
  games; in the others each scene and outcome counts alike. `relations-basic` has no generated scenes. Which of the two
  is the preset, and the quarter, were chosen on other plans of basic games and on unseen basic games.
* "plan" sees only the plan, "scene" only the scene. Counting judges by the number of removals.
* Mean over seeds ± standard deviation. One row of the paper is one run.
* `models/outcome/`, beside this page, has settings, log and scores of each row.
"""


def cell(values: Sequence[float] | None, factor: float = 100.0, digits: int = 1) -> str:
    """Mean and spread over seeds, of shares in %; "-" if there are none."""
    return seeds_cell(values or (), factor, digits)


def accuracy_table(evaluations: Mapping[str, Mapping[str, Any]]) -> str:
    """Accuracy of every row on every column, with the paper's."""
    rows = []
    for name, evaluation in evaluations.items():
        columns = evaluation["columns"]
        each = [cell(columns[column]["accuracy"]) if column in columns else "-" for column in COLUMNS]
        rows.append([name, str(evaluation.get("parameters") or "-"), *each])
    for name, (learned, *others) in PAPER.items():
        rows.append([name, "-", str(learned), "-", "-", "-", "-", *map(str, others)])
    return markdown_table(["row", "numbers", *(TITLES[column] for column in COLUMNS)], rows)


def measures_table(evaluations: Mapping[str, Mapping[str, Any]], column: str) -> str:
    """Every measure of every row on one column, with the interval over games."""
    rows = []
    for name, evaluation in evaluations.items():
        found = evaluation["columns"].get(column)
        if found is None:
            continue
        each = [
            cell(found[measure], *((100.0, 1) if title.endswith("%") else (1.0, 3)))
            for measure, title in MEASURES.items()
        ]
        low, high = found.get("interval over games", (float("nan"), float("nan")))
        interval = f"{100 * low:.0f} to {100 * high:.0f}" if np.isfinite(low) else "-"
        natural = cell(found.get("natural"))
        constant = cell([found["natural constant"]]) if "natural constant" in found else "-"
        rows.append([name, *each, interval, natural, constant])
    header = ["row", *MEASURES.values(), "accuracy by game, 95 %", "natural rates %", "constant %"]
    return markdown_table(header, rows)


def games_table(evaluations: Mapping[str, Mapping[str, Any]], columns: Sequence[str]) -> str:
    """Accuracy of every row in each game."""
    games: dict[str, list[str]] = {}
    for evaluation in evaluations.values():
        for column in columns:
            for game in evaluation["columns"].get(column, {}).get("games", {}):
                games.setdefault(game, [])
    for evaluation in evaluations.values():
        found = {
            game: value
            for column in columns
            for game, value in evaluation["columns"].get(column, {}).get("games", {}).items()
        }
        for game, cells in games.items():
            cells.append(f"{100 * found[game]:.0f}" if game in found else "-")
    return markdown_table(["game", *evaluations], [[game, *cells] for game, cells in games.items()])


def agents_table(agents: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Shares of games solved at the first attempt and within five, by split; mean and spread over seeds."""
    rows = []
    for name, found in agents.items():
        shares = [[[seed[split][k] for seed in found] for k in (0, 4)] for split in PAPER_SPLITS]
        rows.append([name, *(" / ".join(cell(values, digits=0) for values in pair) for pair in shares)])
    return markdown_table(["agent", *(TITLES.get(split, split) for split in PAPER_SPLITS)], rows)


def draw_reliability(path: Path, evaluations: Mapping[str, Mapping[str, Any]], columns: Sequence[str]) -> None:
    """Judged chance against what came true, one panel a column."""
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    figure = Figure(figsize=(4 * len(columns), 4.2), dpi=100, layout="constrained")
    for k, column in enumerate(columns):
        axes = figure.add_subplot(1, len(columns), k + 1)
        axes.plot([0, 1], [0, 1], color="black", linewidth=0.8, linestyle="--")
        for number, (name, evaluation) in enumerate(evaluations.items()):
            if column in evaluation["columns"] and evaluation.get("parameters"):
                bins = evaluation["columns"][column]["reliability"]
                points = [
                    (chance, share)
                    for chance, share in zip(bins["chance"], bins["solved"], strict=True)
                    if chance is not None
                ]
                line = "-" if number < COLOURS else ":"  # so that no two models look alike
                axes.plot(*zip(*points, strict=True), line, color=f"C{number}", marker="o", ms=3, lw=1, label=name)
        axes.set(title=TITLES[column], xlabel="judged chance", ylabel="share that solves", xlim=(0, 1), ylim=(0, 1))
        axes.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize="x-small")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def write(
    out: Path,
    evaluations: Mapping[str, Mapping[str, Any]],
    agents: Mapping[str, Sequence[Mapping[str, Any]]],
    missing: Sequence[str],
    facts: Mapping[str, Any],
) -> None:
    """Write the document and its picture.

    Args:
        out: of the document.
        evaluations: by name of the row, in the order shown.
        agents: of each seed the shares solved within 1, ..., k attempts by split, by name.
        missing: rows that are not trained yet.
        facts: data and provenance, JSON values.
    """
    judged = [column for column in COLUMNS if column != TRAINED]
    trained = {name: evaluation for name, evaluation in evaluations.items() if evaluation.get("parameters")}
    parts = [ABOUT, "## Accuracy, %", accuracy_table(evaluations)]
    if missing:
        parts.append(f"Not trained yet: {', '.join(missing)}.")
    for column in judged:
        if any(column in evaluation["columns"] for evaluation in evaluations.values()):
            parts += [f"## {TITLES[column].capitalize()}", measures_table(evaluations, column)]
    parts.append(
        "Natural rates: as if plans solved each game as often as random ones do; chances are moved to the mean rate of "
        "the basic games. Constant: always the more frequent outcome of each game."
    )
    if trained:
        picture = out.with_name(f"{out.stem}-reliability.png")
        draw_reliability(picture, trained, (HELD, *TESTED))
        parts += ["## Reliability", f"![Judged chance against what came true]({picture.name})"]
    if agents:
        parts += [
            "## As an agent",
            "Each agent judges 1,000 random plans and plays the best. Games solved at the first attempt / within five, "
            "%, mean over repeats and over seeds ± standard deviation over seeds; 60 steps a second.",
            agents_table(agents),
        ]
    parts += [
        "## Accuracy by game, %",
        games_table(trained, (HELD, *TESTED)),
    ]
    parts.append(made_by(facts))
    replace_text(out, "\n\n".join(part.strip() for part in parts) + "\n")

"""`iphyre-jax classifier`: outcome classifiers. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from iphyre_jax.cli.console import option
from iphyre_jax.cli.signals import resumable
from iphyre_jax.files import check_output
from iphyre_jax.models.outcome import compare, storage
from iphyre_jax.models.outcome.plays.sets import COLUMNS, play_sets
from iphyre_jax.models.outcome.report import TITLES, cell
from iphyre_jax.models.settings import row_of
from iphyre_jax.models.storage import Comparison
from iphyre_jax.train.reports.printing import say

ROOT = Path("build/outcome")


@dataclass(frozen=True)
class Train:
    """Train one row of docs/results/outcome.md, or what is left of it, and evaluate it."""

    row: Annotated[tyro.conf.Positional[str], option("ROW", "Name of the row, such as paper-global or relations.")]
    root: Path = ROOT
    """Folder of the runs and of the plays that they learn from."""


@dataclass(frozen=True)
class Evaluate:
    """Print what a trained row is worth."""

    run: Annotated[tyro.conf.Positional[Path], option("RUN", "The run folder.")]


@dataclass(frozen=True)
class Compare:
    """Train every row that is missing and write the report after each."""

    root: Path = ROOT
    """Folder of the runs and of the plays that they learn from."""
    out: Path = Path("docs/results/outcome.md")
    """The document."""
    only: tuple[str, ...] = ()
    """Rows to train, by name; by default all."""
    weights: Path | None = None
    """Folder for the best network of each row that ships; by default they stay in the run folders alone."""


@dataclass(frozen=True)
class ClassifierCommand:
    """Will this plan solve this scene? Train and compare outcome classifiers."""

    action: Annotated[
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Compare, tyro.conf.subcommand("compare")],
        tyro.conf.arg(name=""),
    ]


def run(command: ClassifierCommand, console: Console) -> int:
    """Run a classifier command and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    return resumable(lambda: _run(command.action, console), console)


def _run(action: Train | Evaluate | Compare, console: Console) -> None:
    """Run one of the three."""
    if isinstance(action, Compare):
        check_output("out", action.out, ())
        compare.compare(Comparison(action.root, action.out, action.weights), console, action.only)
        return
    if isinstance(action, Train):
        config = row_of(compare.ROWS, action.row)
        sets = play_sets(action.root / "data", console)
        _print(compare.make_row(action.root, config, sets, console), console)
    else:
        _print(storage.RUNS.read_evaluation(action.run, row=str, columns=dict), console)


def _print(evaluation: Mapping[str, Any], console: Console) -> None:
    """Print the accuracy of an evaluated row on each column."""
    say(console, f"{evaluation['row']}: accuracy %, 60 fps, fresh space, float64")
    for column in COLUMNS:
        if column in evaluation["columns"]:
            say(console, f"{TITLES[column]}: {cell(evaluation['columns'][column]['accuracy'])}")

"""`iphyre-jax sequence`: sequence models. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from iphyre_jax.analyses import oracle
from iphyre_jax.cli.console import option
from iphyre_jax.cli.signals import resumable
from iphyre_jax.files import check_output
from iphyre_jax.models.sequence import compare, report, storage
from iphyre_jax.models.settings import row_of
from iphyre_jax.models.storage import Comparison
from iphyre_jax.train.reports.printing import say

ROOT = Path("build/sequence")


@dataclass(frozen=True)
class Train:
    """Train one row of docs/results/sequence.md, or what is left of it, and evaluate it."""

    row: Annotated[tyro.conf.Positional[str], option("ROW", "Name of the row, such as paper-in-advance.")]
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
    out: Path = Path("docs/results/sequence.md")
    """The document."""
    only: tuple[str, ...] = ()
    """Rows to train, by name; by default all."""
    weights: Path | None = None
    """Folder for the best model of each row that ships; by default they stay in the run folders alone."""


@dataclass(frozen=True)
class SequenceCommand:
    """Models that are asked for a return. Train and compare sequence models."""

    action: Annotated[
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Compare, tyro.conf.subcommand("compare")],
        tyro.conf.arg(name=""),
    ]


def run(command: SequenceCommand, console: Console) -> int:
    """Run a sequence command and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    return resumable(lambda: _run(command.action, console), console)


def _run(action: Train | Evaluate | Compare, console: Console) -> None:
    """Run one of the three."""
    if isinstance(action, Compare):
        best = {fps: oracle.best_known(fps) for fps in oracle.RATES}
        check_output("out", action.out, ())
        compare.compare(Comparison(action.root, action.out, action.weights), best, console, action.only)
        return
    if isinstance(action, Train):
        config = row_of(compare.ROWS, action.row)
        _print(compare.make_row(action.root, config, console), config.fps, console)
    else:
        found = storage.RUNS.read_evaluation(action.run, row=str, modes=dict)
        _print(found, storage.RUNS.read_config(action.run).fps, console)


def _print(evaluation: Mapping[str, Any], fps: int, console: Console) -> None:
    """Print the mean reward of an evaluated row on each split."""
    say(console, f"{evaluation['row']}: mean reward / solved %, {fps} fps, float64")
    for mode in report.MODES:
        if mode in evaluation["modes"]:
            cells = report.result_cells(evaluation["modes"][mode])
            say(console, f"{mode}: " + ", ".join(f"{k} {v}" for k, v in zip(report.SPLITS_SHOWN, cells, strict=False)))

"""`iphyre-jax generate`: make a file of generated scenes, or describe one. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from rich.console import Console

from iphyre_jax.cli.console import option, refuse_unread
from iphyre_jax.cli.signals import with_status
from iphyre_jax.data.generated import GeneratedScenes, generate_scenes, load_generated, save_generated
from iphyre_jax.data.generated.drawing import DEFAULT_KIND, SceneKind
from iphyre_jax.data.generated.pool import ARRAYS, SCHEMA
from iphyre_jax.data.targets import journal_of_new
from iphyre_jax.files import check_output
from iphyre_jax.train.reports.printing import say

PICTURES = 40  # of a sheet
COLUMNS = 8


@dataclass(frozen=True)
class Generate:
    """Make scenes of the ten basic games and their elements that random plans sometimes solve. Or describe a file.

    A run that is interrupted or killed goes on where it was when the same command is given again.
    """

    out: Annotated[Path | None, option("FILE", "The file to write, NAME.npz; NAME.json goes beside it.", "")] = None
    count: int = 20_000
    """Scenes to keep."""
    seed: int = 0
    """Seed of the scenes."""
    protocol: Literal["official", "smooth"] = "official"
    """Random plans are played at 10 steps a second, as agents learn, or at 60."""
    kind: SceneKind = DEFAULT_KIND
    """Elements of the basic games, or unions of two basic games each."""
    describe: Annotated[Path | None, option("FILE", "Describe this file instead.", "")] = None
    sheet: Annotated[Path | None, option("PICTURE", "Draw 40 of the scenes too; needs the extra viewer.", "none")] = (
        None
    )


def run(command: Generate, console: Console) -> int:
    """Run the command and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    return with_status(lambda report: _run(command, console, report), console)


def _run(command: Generate, console: Console, report: Callable[[str], None]) -> int:
    if (command.out is None) == (command.describe is None):
        raise ValueError("out: expected the file to write, --out NAME.npz, or one to describe, --describe NAME.npz")
    check_output("sheet", command.sheet)
    if command.describe is not None:
        refuse_unread(command, ("describe", "sheet"), "with --describe")
    scenes = load_generated(command.describe) if command.describe else _make(command, command.out or Path(), report)
    _describe(scenes, console)
    if command.sheet is not None:
        _draw(scenes, command.sheet)
    return 0


def _make(command: Generate, out: Path, report: Callable[[str], None]) -> GeneratedScenes:
    """Generate and write the scenes."""
    return generate_scenes(
        command.count,
        command.seed,
        protocol=command.protocol,
        kind=command.kind,
        journal=journal_of_new(out, SCHEMA, ARRAYS, "out"),
        report=report,
        save=partial(save_generated, path=out),
    )


def _describe(scenes: GeneratedScenes, console: Console) -> None:
    """Print what was drawn, refused and kept."""
    of = scenes.manifest
    say(console, f"{len(scenes)} scenes of seed {of['seed']}, {of['fps']} fps, {of['dtype']}, reset {of['resets']}")
    say(console, f"drawn: {of['drawn']}, {of['kind']}")
    for reason, count in of["refused"].items():
        say(console, f"  {reason}: {count} ({count / of['drawn']:.1%})")
    say(console, f"kept: {len(scenes)} ({len(scenes) / of['drawn']:.1%}), by the share of random plans that solve")
    for grade, count in of["grades"].items():
        say(console, f"  {grade}: {count} ({count / max(1, len(scenes)):.1%})")
    nearest = "none has the objects of one" if of["nearest_px"] is None else f"{of['nearest_px']:.1f} px"
    say(console, f"nearest to a test game: {nearest}")


def _draw(scenes: GeneratedScenes, path: Path) -> None:
    """Write a contact sheet of evenly chosen scenes, the hardest first."""
    from iphyre_jax.viewer.films import save_picture
    from iphyre_jax.viewer.sheets import contact_sheet, start_of

    some = scenes.select(np.linspace(0, len(scenes) - 1, min(PICTURES, len(scenes))).astype(int))
    ordered = some.select(np.argsort(some.solve_rate, kind="stable"))
    save_picture(path, contact_sheet([start_of(scene) for scene in ordered.scenes], columns=COLUMNS, frame=0))

"""`iphyre-jax world`: world models. Needs the extra `train`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from iphyre_jax.attempts.agents import random_plans
from iphyre_jax.attempts.planner import preferred
from iphyre_jax.checks import check_whole
from iphyre_jax.cli.console import option, say
from iphyre_jax.cli.signals import resumable
from iphyre_jax.models.world import compare, runs, storage
from iphyre_jax.models.world.imagine import WorldImagination
from iphyre_jax.models.world.metrics import HORIZONS
from iphyre_jax.models.world.report import TITLES
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import load_scene
from iphyre_jax.simulation import simulate

ROOT = Path("build/world")


@dataclass(frozen=True)
class Train:
    """Train one row of docs/results/world.md, or what is left of it."""

    row: Annotated[tyro.conf.Positional[str], option("ROW", "Name of the row, such as objects-unlimited or mdrnn-400.")]
    seed: int = 0
    """Of initial weights, plays and batches."""
    root: Path = ROOT
    """Folder of the runs."""


@dataclass(frozen=True)
class Evaluate:
    """Measure runs, or what is left to measure, and write the report."""

    run: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], option("RUN ...", "Run folders.", "none: the report alone")
    ] = ()
    root: Path = ROOT
    """Folder of all runs that the report shows."""
    out: Path = Path("docs/results/world.md")
    """The document."""
    plans: int = 300
    """Plans that are imagined for each game; 0: do not plan."""
    weights: Path | None = None
    """Folder for the best of these runs, as it ships; by default they stay in the run folders alone."""


@dataclass(frozen=True)
class PlanInModel:
    """Imagine random plans of a scene in a world model, and play the best."""

    scene: Annotated[tyro.conf.Positional[str], option("SCENE", "A game's name or a scene file.")]
    model: str = "objects-unlimited"
    """A model of the package, or a run folder."""
    plans: int = 300
    """Imagined plans."""
    best: int = 5
    """How many of them are played and shown."""
    seed: int = 0
    """Of the drawn plans."""


@dataclass(frozen=True)
class WorldCommand:
    """What will the scene look like? Train world models, measure them, plan in them."""

    action: Annotated[
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[PlanInModel, tyro.conf.subcommand("plan")],
        tyro.conf.arg(name=""),
    ]


def run(command: WorldCommand, console: Console) -> int:
    """Run a command of world models and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    return resumable(lambda: _run(command.action, console), console)


def _run(action: Train | Evaluate | PlanInModel, console: Console) -> None:
    """Run one of the three."""
    if isinstance(action, Train):
        config = compare.row_settings(action.row, action.seed)
        runs.train(action.root / config.name, config, console)
    elif isinstance(action, Evaluate):
        _evaluate(action, console)
    else:
        _plan(action, console)


def _evaluate(action: Evaluate, console: Console) -> None:
    check_whole("plans", action.plans, 0)
    for folder in action.run:
        found = compare.evaluate(folder, action.plans, console)
        for column, measures in found["columns"].items():
            errors = " ".join(f"{value:.2f}" for value in measures["median error px"]["model"])
            right = 100 * measures["outcomes"]["right"]
            seconds = " ".join(f"{horizon / 10:g}" for horizon in HORIZONS)
            say(
                console,
                f"{folder.name}: {TITLES[column]}: px after {seconds} s: {errors}; outcomes right {right:.0f} %",
            )
    if action.weights is not None:
        say(console, f"{action.weights}: {', '.join(compare.ship(action.run, action.weights))}")
    compare.write_report(action.root, action.out)


def _plan(action: PlanInModel, console: Console) -> None:
    scene = load_scene(action.scene)
    check_whole("plans", action.plans)
    check_whole("best", action.best, 1, action.plans)
    shipped = action.model in storage.names()
    model = storage.load_model(action.model) if shipped else storage.trained_model(Path(action.model))
    times = random_plans(np.random.default_rng(action.seed), len(scene.eliminable_blocks), action.plans)
    imagined = WorldImagination(model)(scene, times)
    best = preferred(imagined[None])[: action.best]
    played = simulate(scene, plan_to_steps(times[best], 60, "simulate"), fps=60, dtype="float64")
    say(console, f"{scene.name}: best of {action.plans} plans imagined in {action.model}; 60 fps, fresh space, float64")
    for at, index in enumerate(best):
        plan = ",".join("-" if np.isnan(time) else f"{time:g}" for time in times[index])
        say(console, f"{plan}: imagined {imagined[index]:.1f}, played {played.reward[at]:.1f}")

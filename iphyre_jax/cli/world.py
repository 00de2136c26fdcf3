"""`iphyre-jax world`: world models. Needs the extra `train`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console

from iphyre_jax.attempts.planner import different_plans, preferred
from iphyre_jax.checks import check_whole
from iphyre_jax.cli.console import Plan, option
from iphyre_jax.cli.signals import resumable, until_signal
from iphyre_jax.files import check_apart, check_output, replace_text
from iphyre_jax.models.storage import Comparison
from iphyre_jax.models.world import compare, runs, storage
from iphyre_jax.models.world.imagine import WorldImagination
from iphyre_jax.models.world.planning import PLANS, TRIES
from iphyre_jax.models.world.reports.metrics import HORIZONS
from iphyre_jax.models.world.reports.report import TITLES
from iphyre_jax.models.world.roll_outs import draw_errors, frame_seconds, roll_out_plan
from iphyre_jax.plans import parse_plan, plan_to_steps
from iphyre_jax.scenes import load_scene
from iphyre_jax.simulation import simulate
from iphyre_jax.train.reports.printing import say
from iphyre_jax.viewer.page import replay_page

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
    """Measure a run, or what is left to measure; it may be under way."""

    run: Annotated[tyro.conf.Positional[Path], option("RUN", "The run folder.")]
    plans: int = PLANS
    """Plans that are imagined for each game; 0: do not plan."""


@dataclass(frozen=True)
class Compare:
    """Train every run that is missing, three seeds of each row, and write the report after each."""

    root: Path = ROOT
    """Folder of the runs."""
    out: Path = Path("docs/results/world.md")
    """The document."""
    only: tuple[str, ...] = ()
    """Rows to train, by name; by default all."""
    weights: Path | None = None
    """Folder for the best seed of the row that ships; by default it stays in its run folder alone."""


@dataclass(frozen=True)
class PlanInModel:
    """Imagine random plans of a scene in a world model, and play the best."""

    scene: Annotated[tyro.conf.Positional[str], option("SCENE", "A game's name or a scene file.")]
    model: str = "objects-unlimited"
    """A model of the package, or a run folder."""
    plans: int = 300
    """Random plans that are drawn; the different ones are imagined."""
    best: int = 5
    """How many of them are played and shown."""
    seed: int = 0
    """Of the drawn plans."""


@dataclass(frozen=True)
class Film:
    """Show a plan as it is played beside how a world model imagines it, and the model's error over time."""

    scene: Annotated[tyro.conf.Positional[str], option("SCENE", "A game's name or a scene file.")]
    out: Annotated[
        Path,
        option("FILE", "The file to write: .png, .gif or .mp4, or .html, a replay page.", aliases=("-o",)),
    ]
    plan: Plan = ()
    model: str = "objects-unlimited"
    """A model of the package, or a run folder."""
    errors: Annotated[Path | None, option("FILE", "Draw the error of balls over time, .png.", "no picture")] = None


@dataclass(frozen=True)
class WorldCommand:
    """What will the scene look like? Train world models, measure them, plan in them."""

    action: Annotated[
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Compare, tyro.conf.subcommand("compare")]
        | Annotated[PlanInModel, tyro.conf.subcommand("plan")]
        | Annotated[Film, tyro.conf.subcommand("film")],
        tyro.conf.arg(name=""),
    ]


def run(command: WorldCommand, console: Console) -> int:
    """Run a command of world models and return the exit code.

    Raises:
        ValueError, OSError: one line.
    """
    work = partial(_run, command.action, console)
    kept = isinstance(command.action, Train | Evaluate | Compare)
    return resumable(work, console) if kept else until_signal(work)


def _run(action: Train | Evaluate | Compare | PlanInModel | Film, console: Console) -> None:
    """Run one of the five."""
    if isinstance(action, Train):
        config = compare.row_settings(action.row, action.seed)
        runs.train(action.root / config.name, config, console)
    elif isinstance(action, Evaluate):
        _evaluate(action, console)
    elif isinstance(action, Compare):
        check_output("out", action.out, ())
        compare.compare(Comparison(action.root, action.out, action.weights), console, action.only)
    elif isinstance(action, PlanInModel):
        _plan(action, console)
    else:
        _film(action, console)


def _evaluate(action: Evaluate, console: Console) -> None:
    if action.plans:
        check_whole("plans", action.plans, TRIES)
    found = compare.evaluate(action.run, action.plans, console)
    seconds = " ".join(f"{horizon / 10:g}" for horizon in HORIZONS)
    for column, measures in found["columns"].items():
        errors = " ".join(f"{value:.2f}" for value in measures["median error px"]["model"])
        right = 100 * measures["outcomes"]["right"]
        say(console, f"{TITLES[column]}: px after {seconds} s: {errors}; outcomes right {right:.0f} %")
    if action.plans:
        reward, solved = (
            [np.mean([split[key][tries] for split in found["planning"].values()]) for tries in range(2)]
            for key in ("reward", "solved")
        )
        say(
            console,
            f"best of {action.plans} imagined plans: first {reward[0]:.0f} points, {100 * solved[0]:.0f} % solved; "
            f"best of {TRIES}: {reward[1]:.0f}, {100 * solved[1]:.0f} %",
        )


def _film(action: Film, console: Console) -> None:
    scene = load_scene(action.scene)
    check_output("out", action.out, (".html", ".png", ".gif", ".mp4"))
    check_output("errors", action.errors)
    check_apart("errors", action.errors, "out", action.out)
    found = roll_out_plan(storage.named_model(action.model), scene, parse_plan(action.plan, scene)[0])
    model = Path(action.model).name
    plays = {"simulator": found.real, model: found.imagined}
    if action.out.suffix.lower() == ".html":
        replace_text(action.out, replay_page(list(plays.items()), title=f"{scene.name}, imagined by {model}"))
    else:
        from iphyre_jax.viewer.films import save  # needs the extra `viewer`

        save(action.out, list(plays.values()), titles=list(plays))
    if action.errors is not None:
        draw_errors(action.errors, found, f"{scene.name}: error of {model}")
    ends = ", ".join(f"{name} {'solved' if play.success else 'not solved'}" for name, play in plays.items())
    error = found.error["model"]
    at = min(11, len(error) - 1)
    say(console, f"{action.out}: {ends}; error of balls {error[at]:.1f} px after {frame_seconds(at):.1f} s")


def _plan(action: PlanInModel, console: Console) -> None:
    scene = load_scene(action.scene)
    check_whole("plans", action.plans)
    check_whole("best", action.best, 1, action.plans)
    check_whole("seed", action.seed, 0)
    model = storage.named_model(action.model)
    times = different_plans(np.random.default_rng(action.seed), scene, action.plans)
    imagined = WorldImagination(model)(scene, times)
    best = preferred(imagined[None])[: action.best]
    played = simulate(scene, plan_to_steps(times[best], 60, "simulate"), fps=60, dtype="float64")
    say(console, f"{scene.name}: best of {len(times)} plans imagined in {action.model}; 60 fps, fresh space, float64")
    for at, index in enumerate(best):
        plan = " ".join("-" if np.isnan(time) else f"{time:g}" for time in times[index])
        say(console, f"{plan or 'no block'}: imagined {imagined[index]:.1f}, played {played.reward[at]:.1f}")

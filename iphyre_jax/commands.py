"""What `iphyre-jax` can do. Needs the extra `train`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax import scene_commands, viewer_commands
from iphyre_jax.configuration import OFF_WORDS, configure
from iphyre_jax.plans import Rule, plan_to_steps
from iphyre_jax.scenes import GAMES, SPLITS, load_scene
from iphyre_jax.simulation import simulate
from iphyre_jax.train import loop, ppo, runs
from iphyre_jax.train.config import TrainConfig
from iphyre_jax.train.evaluate import Evaluation, evaluate
from iphyre_jax.train.report import COLUMNS, TITLES, split_rows
from iphyre_jax.viewer_commands import PlayPage, Render, Replay

INTERRUPTED = 130
CONFIGURE_VARIABLE = "IPHYRE_JAX_CONFIGURE"


@dataclass(frozen=True)
class Train:
    """Train an agent that plans in advance, evaluate it on the 40 games and leave a run folder."""

    config: Annotated[TrainConfig, tyro.conf.OmitArgPrefixes] = field(default_factory=TrainConfig)
    out: Path | None = None
    """The run folder, new or empty; by default a new one under runs/."""


@dataclass(frozen=True)
class Evaluate:
    """Evaluate a run's policy again and rewrite its evaluation.json and evaluation.md; or score a file of plays."""

    run: tyro.conf.Positional[Path]
    """The run folder, or a file of plays (JSON lines)."""
    unseen: bool = False
    """Play the ten unseen basic games too."""


@dataclass(frozen=True)
class Simulate:
    """Play one plan and print how it ends."""

    scene: tyro.conf.Positional[str]
    """A game's name or a scene file."""
    plan: tuple[str, ...] = ()
    """Seconds at which each eliminable block goes, in list order ("iphyre-jax games" shows them); "never" or "-" for
    one that stays. Missing ones stay."""
    fps: int = 60
    """Physics steps a second."""
    rule: Rule = "simulate"
    """How seconds become steps: "simulate", the driver of people and data sets, or "in_advance", the agents'."""
    resets: int = 1
    """Number of the reset of a reused space; official agents play in the second."""
    dtype: Literal["float64", "float32"] = "float64"
    """Of the physics."""


@dataclass(frozen=True)
class Games:
    """List the games with their splits and eliminable blocks."""

    split: str | None = None
    """Only this one."""


Command = Train | Evaluate | Simulate | Games | scene_commands.SceneCommand | Render | Replay | PlayPage


def run(arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments, do what they ask and return the exit code.

    Calls `configure` first, unless the environment variable IPHYRE_JAX_CONFIGURE is "off".
    """
    command: Command = tyro.cli(
        Annotated[Train, tyro.conf.subcommand("train")]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[Simulate, tyro.conf.subcommand("simulate")]
        | Annotated[Games, tyro.conf.subcommand("games")]
        | Annotated[scene_commands.SceneCommand, tyro.conf.subcommand("scene")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[Replay, tyro.conf.subcommand("replay")]
        | Annotated[PlayPage, tyro.conf.subcommand("play")],
        prog="iphyre-jax",
        description="I-PHYRE in JAX: train and evaluate agents, play plans and games, render them, check scenes.",
        args=None if arguments is None else list(arguments),
    )
    if (
        not isinstance(command, Games | scene_commands.SceneCommand)
        and os.environ.get(CONFIGURE_VARIABLE, "").lower() not in OFF_WORDS
    ):
        configure()
    console = Console()
    if isinstance(command, Train):
        return _train(command, console)
    actions: dict[type, Callable[..., None]] = {
        Evaluate: _evaluate,
        Simulate: _simulate,
        Games: _games,
        scene_commands.SceneCommand: scene_commands.run,
        Render: viewer_commands.render,
        Replay: viewer_commands.replay,
        PlayPage: viewer_commands.play,
    }
    actions[type(command)](command, console)
    return 0


def _train(command: Train, console: Console) -> int:
    """`iphyre-jax train`."""
    config = command.config
    config.check()
    folder = command.out or runs.default_path(config)
    outcome = loop.train(config, folder, console)
    if not outcome.finished:
        console.print(f"Saved in {folder}; `iphyre-jax evaluate {folder}` evaluates it.")
        return INTERRUPTED
    _evaluate_and_report(folder, config, outcome.state, GAMES, console)
    return 0


def _evaluate(command: Evaluate, console: Console) -> None:
    """`iphyre-jax evaluate`."""
    if command.run.is_file():
        viewer_commands.evaluate_plays(command.run, console)
        return
    config, state = runs.load(command.run)
    games = (*GAMES, *SPLITS["unseen_basic"]) if command.unseen else GAMES
    _evaluate_and_report(command.run, config, state, games, console)


def _evaluate_and_report(
    folder: Path, config: TrainConfig, state: ppo.TrainState, games: Sequence[str], console: Console
) -> None:
    """Play the games, write the evaluation into the folder and print the table by split."""
    with console.status(f"evaluating on {len(games)} games"):
        evaluation = evaluate(config, state.params, games)
    runs.write_evaluation(folder, config, evaluation, int(state.update))
    _print_splits(evaluation, config, console)
    console.print(f"More in {folder / 'evaluation.md'}")


def _print_splits(evaluation: Evaluation, config: TrainConfig, console: Console) -> None:
    """The table by split, this run beside the paper's agents and humans."""
    console.print(f"Mean reward and success at {config.fps} fps, action head: {config.head}")
    table = Table(box=box.SIMPLE, pad_edge=False)
    table.add_column()
    for split in COLUMNS:
        table.add_column(TITLES[split], justify="right", no_wrap=True)
    for row in split_rows(evaluation, config):
        table.add_row(row.name, *row.cells, style="bold" if row.ours else None)
    console.print(table)
    console.print("The paper's agents play at 10 fps, its humans (best of five attempts) and oracle at 60 fps.")
    if "unseen_basic" in evaluation.splits:
        for kind in ("greedy", "sampled"):
            score = evaluation.mean(kind, "unseen_basic")
            console.print(f"Unseen basic, {kind}: {score.reward:.1f} ({100 * score.success:.0f} %)")
    if evaluation.faults:
        console.print(f"{evaluation.faults} episodes ended with an unsound world and count as not solved.")


def _simulate(command: Simulate, console: Console) -> None:
    """`iphyre-jax simulate`."""
    scene = load_scene(command.scene)
    blocks = scene.eliminable_blocks
    seconds = viewer_commands.seconds_of(command.plan, scene)
    steps = plan_to_steps(seconds, command.fps, command.rule)
    played = simulate(scene, steps, fps=command.fps, dtype=command.dtype, resets=command.resets)
    for block, step in zip(blocks, steps[0].tolist(), strict=True):
        when = f"before step {step} ({step / command.fps:.3f} s)" if step >= 0 else "never"
        console.print(f"block {block}: {when}")
    solved = "solved" if played.success[0] else "not solved"
    seconds_played = played.steps[0] / command.fps
    console.print(f"{scene.name}: {solved} after {played.steps[0]} steps ({seconds_played:.3f} s)")
    console.print(f"eliminations: {played.eliminations[0]}\nreward: {played.reward[0]:.4f}")
    if played.fault[0]:
        console.print(f"fault: {played.fault[0]}")


def _games(command: Games, console: Console) -> None:
    """`iphyre-jax games`."""
    if command.split is not None and command.split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {command.split!r}")
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in ("game", "split", "objects", "balls"):
        table.add_column(title, no_wrap=True)
    table.add_column("eliminable blocks: end points, px")
    for split in [command.split] if command.split else SPLITS:
        for name in SPLITS[split]:
            scene = load_scene(name)
            ends = (f"{block}: {_points(scene.blocks[block])}" for block in scene.eliminable_blocks)
            table.add_row(name, split, str(scene.n_objects), str(scene.n_balls), "\n".join(ends))
    console.print(table)


def _points(block: np.ndarray) -> str:
    """End points of a block."""
    return "-".join(f"({x:g}, {y:g})" for x, y in block.tolist())

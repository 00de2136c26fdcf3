"""What `iphyre-jax` can do. Needs the extra `train`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax.cli import scenes, train, viewer
from iphyre_jax.cli.viewer import PlayPage, Render, Replay
from iphyre_jax.execution.compilation.cache_folder import OFF_WORDS
from iphyre_jax.execution.configuration import configure
from iphyre_jax.plans import Rule, plan_to_steps
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.simulation import simulate

CONFIGURE_VARIABLE = "IPHYRE_JAX_CONFIGURE"


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


Command = train.TrainingCommand | Simulate | Games | scenes.SceneCommand | Render | Replay | PlayPage


def run(arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments, do what they ask and return the exit code.

    Calls `configure` first, unless the environment variable IPHYRE_JAX_CONFIGURE is "off".
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = _parse(given)
    if (
        not isinstance(command, Games | scenes.SceneCommand)
        and os.environ.get(CONFIGURE_VARIABLE, "").lower() not in OFF_WORDS
    ):
        configure()
    console = Console()
    if isinstance(command, train.TrainingCommand):
        return train.run(command, console)
    actions: dict[type, Callable[..., None]] = {
        Simulate: _simulate,
        Games: _games,
        scenes.SceneCommand: scenes.run,
        Render: viewer.render,
        Replay: viewer.replay,
        PlayPage: viewer.play,
    }
    actions[type(command)](command, console)
    return 0


def _parse(arguments: list[str]) -> Command:
    """Parse the command line; what `train` does by default depends on the agent that it names."""
    default = train.Train()
    if arguments[:1] == ["train"]:
        arguments = train.renamed(arguments)
        default = train.defaults(arguments[1:])
    command: Command = tyro.cli(
        Annotated[train.Train, tyro.conf.subcommand("train", default=default)]
        | Annotated[train.Resume, tyro.conf.subcommand("resume")]
        | Annotated[train.Evaluate, tyro.conf.subcommand("evaluate")]
        | Annotated[train.Compare, tyro.conf.subcommand("compare")]
        | Annotated[Simulate, tyro.conf.subcommand("simulate")]
        | Annotated[Games, tyro.conf.subcommand("games")]
        | Annotated[scenes.SceneCommand, tyro.conf.subcommand("scene")]
        | Annotated[Render, tyro.conf.subcommand("render")]
        | Annotated[Replay, tyro.conf.subcommand("replay")]
        | Annotated[PlayPage, tyro.conf.subcommand("play")],
        prog="iphyre-jax",
        description="I-PHYRE in JAX: train, evaluate and compare agents, play and render games, check scenes.",
        args=arguments,
    )
    return command


def _simulate(command: Simulate, console: Console) -> None:
    """`iphyre-jax simulate`."""
    scene = load_scene(command.scene)
    blocks = scene.eliminable_blocks
    seconds = viewer.seconds_of(command.plan, scene)
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

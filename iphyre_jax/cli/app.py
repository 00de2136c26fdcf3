"""The subcommands of `iphyre-jax`: parsing and dispatch. Needs the extra `train`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import or_
from shutil import get_terminal_size
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax.checks import check_option
from iphyre_jax.cli import analyse, ask, classifier, data, generate, scenes, sequence, train, world
from iphyre_jax.cli.console import CommandConsole, option
from iphyre_jax.cli.signals import until_signal
from iphyre_jax.cli.viewer import pages, render
from iphyre_jax.cli.viewer.pages import PlayPage, Replay, Score
from iphyre_jax.cli.viewer.render import Plan, Render
from iphyre_jax.execution.compilation.cache_folder import OFF_WORDS
from iphyre_jax.execution.configuration import configure, default_options
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.plans import Rule, parse_plan, plan_to_steps
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.simulation import simulate
from iphyre_jax.train.reports.printing import print_table, say
from iphyre_jax.train.storage import pretrained

NARROWEST = 20  # columns of a help text
CONFIGURE_VARIABLE = "IPHYRE_JAX_CONFIGURE"


@dataclass(frozen=True)
class Simulate:
    """Play one plan and print the result."""

    scene: Annotated[tyro.conf.Positional[str], option("SCENE", "A game's name or a scene file.")]
    plan: Plan = ()
    fps: int = 60
    """Physics steps a second."""
    rule: Rule = "simulate"
    """How seconds become steps: as in the official simulator (people, data sets), or as for agents that plan ahead."""
    resets: int = 1
    """Number of the reset in a reused physics space: 1 is a fresh space; official agents play after the second."""
    dtype: Literal["float64", "float32"] = "float64"
    """Number type of the physics."""


@dataclass(frozen=True)
class Games:
    """List the games with their splits and eliminable blocks."""

    split: Annotated[str | None, option("SPLIT", "List only this split.", "all splits")] = None


@dataclass(frozen=True)
class VerifyPretrained:
    """Play the games with a policy of the package and check that it reaches its published scores.

    The exit code is 1 if a score differs.
    """

    name: Annotated[tyro.conf.Positional[str], option("NAME", "Name of the policy, such as ppo-i.")]


def run(arguments: Sequence[str] | None = None) -> int:
    """Parse the arguments, run the command and return the exit code.

    Calls `configure` first, unless the environment variable IPHYRE_JAX_CONFIGURE is "off".
    """
    command = _without_old_spelling(_parse(list(sys.argv[1:] if arguments is None else arguments)))
    if not isinstance(command, Games | scenes.SceneCommand):
        if os.environ.get(CONFIGURE_VARIABLE, "").lower() not in OFF_WORDS:
            configure()
        check_fork()  # some commands use JAX before they play
    action = next(action for kind, action in SUBCOMMANDS.values() if isinstance(command, kind))
    with default_options():
        return action(command, CommandConsole()) or 0


def _parse(arguments: list[str]) -> object:
    """Parse the command line; the defaults of `train` depend on the agent that the arguments name."""
    defaults = {"train": train.Train()}
    if arguments[:1] == ["train"]:
        arguments = train.renamed(arguments)
        defaults["train"] = train.defaults(arguments[1:])
    kinds = [
        Annotated[kind, tyro.conf.subcommand(name, default=defaults.get(name, tyro.MISSING_NONPROP))]
        for name, (kind, _) in SUBCOMMANDS.items()
    ]
    commands: Any = reduce(or_, kinds)
    description = (
        "I-PHYRE in JAX: train, evaluate and compare agents, play and render games, check scenes. "
        "iphyre-jax --version prints the version."
    )
    if get_terminal_size().columns < NARROWEST:  # the parser never ends with some five
        os.environ["COLUMNS"] = str(NARROWEST)
    command: object = tyro.cli(commands, prog="iphyre-jax", description=description, args=arguments)
    return command


def _without_old_spelling(command: object) -> object:
    """Replace `evaluate NAME` and `evaluate FILE`, with a warning, by the commands that took their place."""
    if not isinstance(command, train.Evaluate):
        return command
    replacement: VerifyPretrained | Score
    if command.run.is_file():
        name, replacement = "score", Score(command.run)
    elif not command.run.exists() and str(command.run) in pretrained.names():
        name, replacement = "verify-pretrained", VerifyPretrained(str(command.run))
    else:
        return command
    old, new = f"evaluate {command.run}", f"{name} {command.run}"
    print(f"iphyre-jax: FutureWarning: `{old}` is deprecated; use `iphyre-jax {new}`", file=sys.stderr)
    return replacement


def _verify_pretrained(command: VerifyPretrained, console: Console) -> int:
    """`iphyre-jax verify-pretrained`."""
    return train.verify_pretrained(check_option("name", command.name, pretrained.names()), console)


def _simulate(command: Simulate, console: Console) -> None:
    """`iphyre-jax simulate`."""
    scene = load_scene(command.scene)
    plan = parse_plan(command.plan, scene)
    steps = plan_to_steps(plan, command.fps, command.rule)
    played = simulate(scene, steps, fps=command.fps, dtype=command.dtype, resets=command.resets)
    for block, second, step in zip(scene.eliminable_blocks, plan[0].tolist(), steps[0].tolist(), strict=True):
        when = f"before step {step} ({step / command.fps:.3f} s)" if step >= 0 else "never"
        is_lost = step < 0 and not np.isnan(second)
        why = f", as removals come after 0 s and within {TIME_LIMIT:g} s" if is_lost else ""
        say(console, f"block {block}: {when}{why}")
    solved = "solved" if played.success[0] else "not solved"
    seconds_played = played.steps[0] / command.fps
    say(console, f"{scene.name}: {solved} after {played.steps[0]} steps ({seconds_played:.3f} s)")
    say(console, f"eliminations: {played.eliminations[0]}\nreward: {played.reward[0]:.4f}")
    if played.fault[0]:
        say(console, f"fault: {played.fault[0]}")


def _games(command: Games, console: Console) -> None:
    """`iphyre-jax games`."""
    chosen = list(SPLITS) if command.split is None else [check_option("split", command.split, list(SPLITS))]
    table = Table(box=box.SIMPLE, pad_edge=False)
    for title in ("game", "split", "objects", "balls"):
        table.add_column(title)
    table.add_column("eliminable blocks: end points, px")
    for split in chosen:
        for name in SPLITS[split]:
            scene = load_scene(name)
            ends = (f"{block}: {_end_points(scene.blocks[block])}" for block in scene.eliminable_blocks)
            table.add_row(name, split, str(scene.n_objects), str(scene.n_balls), "\n".join(ends))
    print_table(console, table)


def _end_points(block: np.ndarray) -> str:
    """Write the end points of a block, px."""
    return "-".join(f"({x:g}, {y:g})" for x, y in block.tolist())


SUBCOMMANDS: dict[str, tuple[type, Callable[[Any, Console], int | None]]] = {
    "train": (train.Train, train.run),
    "resume": (train.Resume, train.run),
    "evaluate": (train.Evaluate, train.run),
    "compare": (train.Compare, train.run),
    "verify-pretrained": (VerifyPretrained, _verify_pretrained),
    "analyse": (analyse.Analyse, analyse.run),
    "ask": (ask.Ask, ask.run),
    "classifier": (classifier.ClassifierCommand, classifier.run),
    "sequence": (sequence.SequenceCommand, sequence.run),
    "world": (world.WorldCommand, world.run),
    "simulate": (Simulate, _simulate),
    "games": (Games, _games),
    "scene": (scenes.SceneCommand, scenes.run),
    "render": (Render, lambda command, console: until_signal(partial(render.render, command, console))),
    "replay": (Replay, lambda command, console: until_signal(partial(pages.replay, command, console))),
    "play": (PlayPage, pages.play),
    "score": (Score, pages.score),
    "collect": (data.Collect, data.run),
    "generate": (generate.Generate, generate.run),
}

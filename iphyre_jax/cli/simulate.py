"""`iphyre-jax simulate` and `games`: play one plan, list the games. Needs the extra `train`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from iphyre_jax.checks import check_option
from iphyre_jax.cli.console import Plan, option
from iphyre_jax.plans import Rule, parse_plan, plan_to_steps
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import SPLITS, load_scene
from iphyre_jax.simulation import simulate
from iphyre_jax.train.reports.printing import print_table, say


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


def run(command: Simulate, console: Console) -> None:
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


def games(command: Games, console: Console) -> None:
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

"""``python -m parity``: compare the solver with pymunk on random plans, print the tables, save the report."""

import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console

import iphyre_jax
from iphyre_jax.memory import check_memory
from iphyre_jax.physics import Topology
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.scenes.library import check_names_differ
from parity.command import (
    options_as_json,
    progress_bar,
    report_console,
    require_at_least,
    require_once,
    require_output,
    require_rates,
    require_steps,
)
from parity.plans import PlanSet
from parity.play import DURATION, GameResult, Task, compare_games
from parity.reports.report import publish, run_info
from parity.reports.tables import sections

PLAYS_A_TASK = 256  # two full chunks
BYTES_OF_PLAN = 1000  # drawn, played and compared, at least

Rate = Literal[60, 10]
Dtype = Literal["float64", "float32"]


@dataclass(frozen=True)
class Options:
    """Compare the solver with pymunk: games x random plans x frame rates x types.

    Attributes:
        games: games to compare; by default all forty.
        unseen: compare the ten unseen basic layouts instead of the forty games.
        scene: scene files to compare instead of games.
        plans: random plans a game.
        plan_set: "early": removal times in (0, 6) s; "late": in [0, 10) s, the first step included.
        fps: frame rates; each has tables of its own.
        dtype: types to run ours in.
        resets: number of the reset to play in; the official learning environments play in the second.
        seed: seed of the plans.
        duration: seconds of a play.
        workers: processes among which the games are shared.
        perturbations: relative changes of gravity; under each, pymunk is compared with itself.
        statistics: seconds of one play of each game in which to count energy, momentum and contacts; 0 for none.
        out: folder of the report: a page, Markdown and JSON.
        name: of these files, without the ending.
    """

    games: tuple[str, ...] = ()
    unseen: bool = False
    scene: tuple[Path, ...] = ()
    plans: int = 50
    plan_set: PlanSet = "early"
    fps: tuple[Rate, ...] = (60, 10)
    dtype: tuple[Dtype, ...] = ("float64", "float32")
    resets: int = 1
    seed: int = 0
    duration: float = DURATION
    workers: int = 2
    perturbations: tuple[float, ...] = (1e-12, 1e-9, 1e-6)
    statistics: float = 5.0
    out: Path = field(default_factory=lambda: Path("parity") / "results")
    name: str = "parity"


def scenes(options: Options) -> list[str]:
    """The names and files of the games to compare."""
    chosen = [*options.games, *map(str, options.scene)]
    if options.unseen:
        chosen += iphyre_jax.SPLITS["unseen_basic"]
    return chosen or list(iphyre_jax.GAMES)


def check(options: Options) -> None:
    """Check the options.

    Raises:
        ValueError: an option is wrong; the message names it and what was expected.
        OSError: a scene file cannot be read.
    """
    require_at_least(options, plans=1, resets=1, workers=1, seed=0)
    check_memory("--plans", BYTES_OF_PLAN * options.plans, "compare fewer plans")
    if not 0 <= options.statistics < math.inf:
        raise ValueError(f"--statistics: expected seconds, at least 0, got {options.statistics}")
    for part in options.perturbations:
        if not 0 < abs(part) < 1:
            raise ValueError(f"--perturbations: expected numbers between -1 and 1 but not 0, got {part}")
    if not options.dtype:
        raise ValueError("--dtype: expected at least one value")
    require_once("--dtype", options.dtype, "type")
    require_rates(options.fps, options.duration)
    names = scenes(options)
    if len(set(names)) < len(names):
        raise ValueError("--games, --scene: expected each scene once")
    require_output(options.out, options.name)
    loaded = [iphyre_jax.load_scene(name) for name in names]
    for scene in loaded:
        require_steps(scene, options.fps, options.duration)
    check_names_differ("--games, --scene", loaded)


def tasks_of(options: Options) -> list[Task]:
    """Group scenes by topology, so that they share chunks and programs; the costliest tasks come first."""
    o = options
    groups: dict[Topology, list[str]] = {}
    for name in scenes(o):
        groups.setdefault(topology_of(iphyre_jax.load_scene(name)), []).append(name)
    size = max(1, PLAYS_A_TASK // o.plans)
    parts = [
        (topology.moving, tuple(names[start : start + size]))
        for topology, names in groups.items()
        for start in range(0, len(names), size)
    ]
    settings = o.plans, o.fps, o.dtype, o.resets, o.seed, o.plan_set, o.duration, o.perturbations
    return [
        Task(names, *settings, statistics=o.statistics)
        for _, names in sorted(parts, key=lambda part: -part[0] * len(part[1]))
    ]


def compare(options: Options, console: Console) -> list[GameResult]:
    """Run the comparison and show its progress; return the results in the order of the games."""
    tasks = tasks_of(options)
    by_scene: dict[str, list[GameResult]] = {}
    with progress_bar(console) as progress:
        bar = progress.add_task("games", total=len(scenes(options)))
        for index, results in compare_games(tasks, min(options.workers, len(tasks))):
            each = len(results) // len(tasks[index].scenes)
            for place, name in enumerate(tasks[index].scenes):
                by_scene[str(name)] = results[each * place : each * (place + 1)]
            progress.update(bar, advance=len(tasks[index].scenes), description=results[-1].game)
    return [result for name in scenes(options) for result in by_scene[name]]


def main(arguments: list[str] | None = None) -> int:
    """Run the comparison, print and save it.

    Returns:
        0 if every target is met, 1 if not, 2 for bad options, 130 if interrupted.
    """
    options = tyro.cli(Options, args=arguments, prog="python -m parity")
    console = report_console()
    try:
        check(options)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    info = run_info(options_as_json(options))  # before the run, so that it names the commit that runs
    try:
        results = compare(options, console)
    except KeyboardInterrupt:
        print("interrupted; nothing was written", file=sys.stderr)
        return 130
    return publish(options.out, options.name, sections(results), results, info, console)


if __name__ == "__main__":
    sys.exit(main())

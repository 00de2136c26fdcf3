"""``python -m benchmarks``: measure all engines side by side, print tables and save them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NoReturn, TypeVar

import tyro
from rich.progress import Progress, TaskID

import iphyre_jax
from benchmarks import decision_rate, plots, report, scaling, startup
from benchmarks.engines import engines, ours
from benchmarks.measure import compare
from benchmarks.report import Results
from benchmarks.worker_pool import GAME_FACTOR, WorkerPool
from benchmarks.workload import make_workload
from iphyre_jax.checks import check_option, check_whole
from iphyre_jax.execution.configuration import usable_cores
from iphyre_jax.files import replace_text
from parity.command import (
    options_as_json,
    progress_bar,
    report_console,
    require_at_least,
    require_once,
    require_output,
)

NAME = "benchmarks"  # of the report's files
MIN_SECONDS = 0.3  # of a repeat
MAX_SCALING_REPEATS = 3  # because a quarter of a million worlds take long
STARTUP_WORLDS = 1024
Rate = Literal[10, 60]
Part = Literal["mixture", "games", "startup", "scaling", "decisions"]
Found = TypeVar("Found")
PARTS: tuple[Part, ...] = ("mixture", "games", "startup", "scaling", "decisions")


@dataclass(frozen=True)
class Options:
    """Measure steps a second of this project, of pymunk, of the official class and of Jax2D on the same plans.

    Attributes:
        quick: take a few minutes only: the mixture of games at 10 fps with few plans and repeats, without Jax2D; sets
            the options parts, fps, repeats and plans.
        games: games to measure, one by one and as a mixture; by default all forty.
        parts: what to measure: all engines on the mixture; all engines game by game; times to a first result; scaling
            with batch, objects, moving bodies and steps; decisions on the fly beside plain simulation.
        fps: frame rates; each has tables of its own.
        repeats: how often to measure each engine.
        plans: plans a game in the mixture at 10 fps; slower engines play only the first of them.
        batches: batch sizes of the scaling table, in worlds.
        without: engines to leave out, "official" or "jax2d".
        cores: processes or threads of each engine; by default all usable cores.
        seed: seed of the plans.
        out: folder of JSON and PNG.
    """

    quick: bool = False
    games: tuple[str, ...] = ()
    parts: tuple[Part, ...] = PARTS
    fps: tuple[Rate, ...] = (10, 60)
    repeats: int = 5
    plans: int = 1024
    batches: tuple[int, ...] = (64, 256, 1024, 4096, 16384, 65536, 262144)
    without: tuple[Literal["official", "jax2d"], ...] = ()
    cores: int = field(default_factory=usable_cores)
    seed: int = 0
    out: Path = Path("benchmarks") / "results"

    def resolved(self) -> Options:
        """Check the options and apply `quick`.

        Raises:
            ValueError: an option is wrong; the message names it and what was expected.
            OSError: the folder cannot be made.
        """
        require_at_least(self, repeats=1, plans=1, seed=0)
        check_whole("--cores", self.cores, 1, usable_cores())
        if not self.parts or not self.fps or not self.batches or min(self.batches) < 1:
            raise ValueError("--parts, --fps, --batches: expected at least one value, and batches of at least 1")
        games = self.games or iphyre_jax.GAMES
        for game in games:
            check_option("--games", game, iphyre_jax.GAMES)
        require_once("--games", games)
        require_once("--fps", self.fps)
        require_once("--parts", self.parts)
        require_output(self.out, NAME)
        changes = {"parts": ("mixture",), "fps": (10,), "repeats": 3, "plans": 256} if self.quick else {}
        without = tuple(dict.fromkeys((*self.without, *(("jax2d",) if self.quick else ()))))
        return Options(**{**vars(self), "games": tuple(games), "without": without, **changes})


class Log:
    """One progress bar for each part; every result is saved at once, so that a killed run keeps its results."""

    def __init__(self, progress: Progress, results: Results, folder: Path) -> None:
        self.progress, self.results, self.folder = progress, results, folder
        self.task: TaskID | None = None

    def start(self, name: str, total: int) -> None:
        """Begin a part of `total` pieces."""
        self.task = self.progress.add_task(name, total=total)

    def saver(self, kept: list[Found]) -> Callable[[list[Found]], None]:
        """Return a function that adds the results of a piece to `kept`, saves them and advances the bar."""

        def done(found: list[Found]) -> None:
            kept.extend(found)
            save_json(self.results, self.folder)
            if self.task is not None:
                self.progress.advance(self.task)

        return done


def measure(options: Options, results: Results, log: Log) -> None:
    """Measure the parts that the options name; put everything into `results`."""
    o = options
    workloads = [o.games] if "mixture" in o.parts else []
    workloads += [(game,) for game in o.games] if "games" in o.parts and len(o.games) > 1 else []
    if workloads:
        measure_engines(o, workloads, results, log)
    sizes = [game for game in startup.one_game_per_size() if game in o.games]
    jobs = [[game] for game in sizes or o.games]
    jobs += [list(o.games)] if len(o.games) > 1 else []
    if "startup" in o.parts:
        log.start("times to a first result", len(jobs))
        startup.measure_startups(jobs, STARTUP_WORLDS, log.saver(results.startups))
    if "decisions" in o.parts:
        log.start("decisions on the fly", len(jobs) * len(o.fps))
        decision_rate.measure_decisions(jobs, o.fps, o.repeats, log.saver(results.decisions))
    if "scaling" in o.parts:
        measure_scaling(o, results, log)


def measure_scaling(options: Options, results: Results, log: Log) -> None:
    """Measure scaling in float32 with sizes and with batches."""
    o, repeats = options, min(options.repeats, MAX_SCALING_REPEATS)
    results.bytes_a_world |= {
        game: {dtype: scaling.carried_bytes(game, dtype) for dtype in ("float32", "float64")} for game in o.games
    }
    log.start("objects, moving bodies, steps", len(scaling.sizes()))
    with WorkerPool(ours("float32", o.cores, o.plans, "cache")) as pool:
        scaling.measure_sizes(pool, repeats, o.seed, log.saver(results.scaling_size))
    players = [(n, "thread") for n in sorted({1, o.cores})] + [(o.cores, "device")]
    log.start("batch sizes", len(o.batches))
    with ExitStack() as stack:
        pools = {
            f"{n} {what}{'s' * (n > 1)}": stack.enter_context(
                WorkerPool(ours("float32", n, max(o.batches), "cache", f"{what}s"))
            )
            for n, what in players
        }
        scaling.measure_batches(pools, o.games, o.batches, repeats, o.seed, log.saver(results.scaling_batch))


def measure_engines(options: Options, workloads: Sequence[tuple[str, ...]], results: Results, log: Log) -> None:
    """Measure all engines on each workload, one frame rate after the other."""
    o = options
    chosen, problems = engines(o.cores, o.plans, o.without)
    results.problems += problems
    with ExitStack() as stack:
        pools = []
        for engine in chosen:
            try:
                pools.append(stack.enter_context(WorkerPool(engine)))
            except RuntimeError as error:
                results.problems.append(f"not measured: {error}")
                continue
            results.engines[engine.name] = {"processes": engine.processes, "versions": pools[-1].versions}
        for fps in o.fps:
            log.start(f"engines, {fps} fps", len(workloads))
            for games in workloads:
                taking_part = [pool for pool in pools if pool.engine.per_game or len(games) > 1]
                plans = max(pool.engine.plans_per_game for pool in taking_part)
                workload = make_workload(games, plans * (GAME_FACTOR if len(games) == 1 else 1), fps, o.seed)
                log.saver(results.measurements)(compare(taking_part, workload, o.repeats, MIN_SECONDS))


def save_json(results: Results, folder: Path) -> Path:
    """Write the JSON; a reader sees the old file or the new one, never a part."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{NAME}.json"
    replace_text(file, report.as_json(results))
    return file


def save(results: Results, folder: Path) -> list[Path]:
    """Write the JSON and the pictures; return the files."""
    file = save_json(results, folder)
    drawn = [(plots.bars, folder / "engines.png"), (plots.scaling, folder / "scaling.png")]
    return [file, *(picture for draw, picture in drawn if draw(results, picture))]


def _interrupt(*_: Any) -> NoReturn:  # noqa: ANN401 - number and frame of a signal
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and save; return 0, or 1 if a measurement fails, 2 for bad options, 130 if interrupted."""
    options = tyro.cli(Options, args=arguments, prog="python -m benchmarks")
    console = report_console()
    try:
        options = options.resolved()
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    info = report.run_info(options_as_json(options))
    results = Results(info, report.load_warnings(info))
    code = 0
    signal.signal(signal.SIGTERM, _interrupt)  # ends the workers, then shows and saves the results so far
    with progress_bar(console) as progress:
        try:
            measure(options, results, Log(progress, results, options.out))
        except RuntimeError as error:
            results.problems.append(str(error))
            code = 1
        except KeyboardInterrupt:
            results.problems.append("interrupted; the rest is missing")
            code = 130
    report.show(results, console)
    for file in save(results, options.out):
        console.print(f"saved {file}", highlight=False)
    return code


if __name__ == "__main__":
    sys.exit(main())

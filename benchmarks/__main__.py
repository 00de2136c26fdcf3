"""``python -m benchmarks``: measure all engines side by side, print tables and save them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

import iphyre_jax
from benchmarks import deciding, plots, report, scaling, startup
from benchmarks.crew import GAME_FACTOR, Crew
from benchmarks.engines import engines, ours
from benchmarks.measure import compare
from benchmarks.report import Results
from benchmarks.work import make_work
from iphyre_jax.configuration import usable_cores

REPORT_WIDTH = 130  # columns, where the output is not a terminal
LEAST_SECONDS = 0.3  # of a turn
Rate = Literal[10, 60]
Part = Literal["mixture", "games", "startup", "scaling", "decisions"]
PARTS: tuple[Part, ...] = ("mixture", "games", "startup", "scaling", "decisions")


@dataclass(frozen=True)
class Options:
    """Measure steps a second of this project, of pymunk, of the official class and of Jax2D on the same plans.

    Attributes:
        quick: a few minutes: the mixture of all games at 10 fps, few plans and turns, without Jax2D; other options are
            as given, except parts, fps, turns and plans.
        games: games to measure, on their own and as the mixture; all forty if none is named.
        parts: what to measure: all engines on the mixture, game by game, times to a first result, batch sizes,
            decisions on the fly beside plain simulation.
        fps: frame rates; each has tables of its own.
        turns: times that each engine is measured.
        plans: plans a game in the mixture, at 10 fps; slower engines play the first of them.
        batches: worlds of the scaling table.
        without: engines to leave out, "official" or "jax2d".
        cores: processes or threads for each engine; by default all that may be used.
        seed: seed of the plans.
        out: folder for JSON and PNG.
    """

    quick: bool = False
    games: tuple[str, ...] = ()
    parts: tuple[Part, ...] = PARTS
    fps: tuple[Rate, ...] = (10, 60)
    turns: int = 5
    plans: int = 1024
    batches: tuple[int, ...] = (64, 256, 1024, 4096, 16384, 65536, 262144)
    without: tuple[Literal["official", "jax2d"], ...] = ()
    cores: int = field(default_factory=usable_cores)
    seed: int = 0
    out: Path = Path("benchmarks") / "results"

    def settled(self) -> Options:
        """The options with what `quick` means, checked.

        Raises:
            ValueError: naming the option and what was expected.
        """
        for name, least in (("turns", 1), ("plans", 1), ("cores", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"--{name}: expected an integer of at least {least}, got {getattr(self, name)}")
        if not self.parts or not self.fps or not self.batches or min(self.batches) < 1:
            raise ValueError("--parts, --fps, --batches: expected at least one value, and batches of at least 1")
        games = self.games or iphyre_jax.GAMES
        for game in games:
            iphyre_jax.load_scene(game)
        changes = {"parts": ("mixture",), "fps": (10,), "turns": 3, "plans": 256} if self.quick else {}
        without = self.without or (("jax2d",) if self.quick else ())
        return Options(**{**vars(self), "games": tuple(games), "without": without, **changes})


class Bar:
    """One progress bar a part."""

    def __init__(self, progress: Progress) -> None:
        self.progress = progress
        self.task: TaskID | None = None

    def start(self, name: str, total: int) -> None:
        """Begin a part."""
        self.task = self.progress.add_task(name, total=total)

    def advance(self) -> None:
        """One more is done."""
        if self.task is not None:
            self.progress.advance(self.task)


def measure(options: Options, results: Results, bar: Bar) -> None:
    """Measure what the options ask for, into `results`, so that an interrupted run has what it found."""
    o = options
    for fps in o.fps:
        works = [o.games] if "mixture" in o.parts else []
        works += [(game,) for game in o.games] if "games" in o.parts and len(o.games) > 1 else []
        if works:
            side_by_side(o, fps, works, results, bar)
    if "startup" in o.parts:
        jobs = [[game] for game in startup.one_for_each_size() if game in o.games]
        jobs += [list(o.games)] if len(o.games) > 1 else []
        bar.start("times to a first result", len(jobs))
        results.startups += startup.startups(jobs, 1024, bar.advance)
    if "decisions" in o.parts:
        jobs = [[game] for game in startup.one_for_each_size() if game in o.games]
        jobs += [list(o.games)] if len(o.games) > 1 else []
        bar.start("decisions on the fly", len(jobs) * len(o.fps))
        results.decisions += deciding.deciding(jobs, o.fps, o.turns, bar.advance)
    if "scaling" in o.parts:
        results.bytes_a_world |= {
            game: {dtype: scaling.carried_bytes(game, dtype) for dtype in ("float32", "float64")} for game in o.games
        }
        bar.start("batch sizes", len(o.batches))
        with ExitStack() as stack:
            numbers = sorted({1, o.cores})
            crews = {n: stack.enter_context(Crew(ours("float32", n, max(o.batches)))) for n in numbers}
            results.scales += scaling.scale(crews, o.games, o.batches, o.turns, o.seed, bar.advance)


def side_by_side(options: Options, fps: int, works: Sequence[tuple[str, ...]], results: Results, bar: Bar) -> None:
    """Measure all engines at one frame rate, in turns on each work."""
    o = options
    chosen, problems = engines(o.cores, o.plans, fps, o.without)
    results.problems += [problem for problem in problems if problem not in results.problems]
    bar.start(f"engines, {fps} fps", len(works))
    with ExitStack() as stack:
        crews = []
        for engine in chosen:
            try:
                crews.append(stack.enter_context(Crew(engine)))
            except RuntimeError as error:
                results.problems.append(f"not measured: {error}")
                continue
            results.engines[engine.name] = {"processes": engine.processes, "versions": crews[-1].versions}
        for games in works:
            single = len(games) == 1
            taking_part = [crew for crew in crews if crew.engine.per_game or not single]
            rounds = max(crew.engine.rounds for crew in taking_part) * (GAME_FACTOR if single else 1)
            work = make_work(games, rounds, fps, o.seed)
            results.measurements += compare(taking_part, work, o.turns, LEAST_SECONDS)
            bar.advance()


def save(results: Results, folder: Path) -> list[Path]:
    """Write the JSON and the pictures; return what was written."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "benchmarks.json").write_text(report.as_json(results), encoding="utf-8")
    drawn = [(plots.bars, folder / "engines.png"), (plots.scaling, folder / "scaling.png")]
    return [folder / "benchmarks.json", *(file for draw, file in drawn if draw(results, file))]


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and save; 0 if all went well, 2 for bad options, 1 if a measurement fails, 130 after Ctrl-C."""
    options = tyro.cli(Options, args=arguments, prog="python -m benchmarks")
    console = Console(width=None if sys.stdout.isatty() else REPORT_WIDTH)
    try:
        options = options.settled()
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    around = report.circumstances({**asdict(options), "out": str(options.out)})
    results = Results(around, report.disturbance(around))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    code = 0
    with Progress(*columns, console=console) as progress:
        try:
            measure(options, results, Bar(progress))
        except RuntimeError as error:
            results.problems.append(str(error))
            code = 1
        except KeyboardInterrupt:
            results.problems.append("ended by the user; the rest is missing")
            code = 130
    report.show(results, console)
    for file in save(results, options.out):
        console.print(f"saved {file}", highlight=False)
    return code


if __name__ == "__main__":
    sys.exit(main())

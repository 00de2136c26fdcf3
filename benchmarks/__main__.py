"""``python -m benchmarks``: measure all engines side by side, print tables and save them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NoReturn, TypeVar

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

import iphyre_jax
from benchmarks import decision_rate, plots, report, scaling_batch, scaling_size, startup
from benchmarks.engines import engines, ours
from benchmarks.measure import compare
from benchmarks.report import Results
from benchmarks.worker_pool import GAME_FACTOR, Crew
from benchmarks.workload import make_work
from iphyre_jax.execution.configuration import usable_cores
from iphyre_jax.files import replace_text

REPORT_WIDTH = 130  # columns, where the output is not a terminal
LEAST_SECONDS = 0.3  # of a turn
MOST_SCALING_TURNS = 3  # a quarter of a million worlds take a while
Rate = Literal[10, 60]
Part = Literal["mixture", "games", "startup", "scaling", "decisions"]
Found = TypeVar("Found")
PARTS: tuple[Part, ...] = ("mixture", "games", "startup", "scaling", "decisions")


@dataclass(frozen=True)
class Options:
    """Measure steps a second of this project, of pymunk, of the official class and of Jax2D on the same plans.

    Attributes:
        quick: a few minutes: the mixture of all games at 10 fps, few plans and turns, without Jax2D; other options are
            as given, except parts, fps, turns and plans.
        games: games to measure, on their own and as the mixture; all forty if none is named.
        parts: what to measure: all engines on the mixture, game by game, times to a first result,
            what grows with batch, objects, moving bodies and steps, decisions on the fly beside plain simulation.
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


class Log:
    """One progress bar a part, and the results so far in their file: who kills a run keeps what it has found."""

    def __init__(self, progress: Progress, results: Results, folder: Path) -> None:
        self.progress, self.results, self.folder = progress, results, folder
        self.task: TaskID | None = None

    def start(self, name: str, total: int) -> None:
        """Begin a part."""
        self.task = self.progress.add_task(name, total=total)

    def into(self, kept: list[Found]) -> Callable[[list[Found]], None]:
        """Return what keeps the results of a part's next piece."""

        def done(found: list[Found]) -> None:
            kept.extend(found)
            save_json(self.results, self.folder)
            if self.task is not None:
                self.progress.advance(self.task)

        return done


def measure(options: Options, results: Results, log: Log) -> None:
    """Measure what the options ask for, into `results`."""
    o = options
    works = [o.games] if "mixture" in o.parts else []
    works += [(game,) for game in o.games] if "games" in o.parts and len(o.games) > 1 else []
    if works:
        side_by_side(o, works, results, log)
    jobs = [[game] for game in startup.one_for_each_size() if game in o.games]
    jobs += [list(o.games)] if len(o.games) > 1 else []
    if "startup" in o.parts:
        log.start("times to a first result", len(jobs))
        startup.startups(jobs, 1024, log.into(results.startups))
    if "decisions" in o.parts:
        log.start("decisions on the fly", len(jobs) * len(o.fps))
        decision_rate.deciding(jobs, o.fps, o.turns, log.into(results.decisions))
    if "scaling" in o.parts:
        scales(o, results, log)


def scales(options: Options, results: Results, log: Log) -> None:
    """Measure what grows with what, in float32."""
    o, turns = options, min(options.turns, MOST_SCALING_TURNS)
    results.bytes_a_world |= {
        game: {dtype: scaling_batch.carried_bytes(game, dtype) for dtype in ("float32", "float64")} for game in o.games
    }
    log.start("objects, moving bodies, steps", len(scaling_size.sizes()))
    with Crew(ours("float32", o.cores, o.plans, "cache")) as crew:
        scaling_size.growth(crew, turns, o.seed, log.into(results.growths))
    players = [(n, "thread") for n in sorted({1, o.cores})] + [(o.cores, "device")]
    log.start("batch sizes", len(o.batches))
    with ExitStack() as stack:
        crews = {
            f"{n} {what}{'s' * (n > 1)}": stack.enter_context(
                Crew(ours("float32", n, max(o.batches), "cache", f"{what}s"))
            )
            for n, what in players
        }
        scaling_batch.scale(crews, o.games, o.batches, turns, o.seed, log.into(results.scales))


def side_by_side(options: Options, works: Sequence[tuple[str, ...]], results: Results, log: Log) -> None:
    """Measure all engines, in turns on each work, at one frame rate after the other."""
    o = options
    chosen, problems = engines(o.cores, o.plans, o.without)
    results.problems += problems
    with ExitStack() as stack:
        crews = []
        for engine in chosen:
            try:
                crews.append(stack.enter_context(Crew(engine)))
            except RuntimeError as error:
                results.problems.append(f"not measured: {error}")
                continue
            results.engines[engine.name] = {"processes": engine.processes, "versions": crews[-1].versions}
        for fps in o.fps:
            log.start(f"engines, {fps} fps", len(works))
            for games in works:
                taking_part = [crew for crew in crews if crew.engine.per_game or len(games) > 1]
                rounds = max(crew.engine.rounds for crew in taking_part)
                work = make_work(games, rounds * (GAME_FACTOR if len(games) == 1 else 1), fps, o.seed)
                log.into(results.measurements)(compare(taking_part, work, o.turns, LEAST_SECONDS))


def save_json(results: Results, folder: Path) -> Path:
    """Write the JSON, in one move."""
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "benchmarks.json"
    replace_text(file, report.as_json(results))
    return file


def save(results: Results, folder: Path) -> list[Path]:
    """Write the JSON and the pictures; return what was written."""
    file = save_json(results, folder)
    drawn = [(plots.bars, folder / "engines.png"), (plots.scaling, folder / "scaling.png")]
    return [file, *(picture for draw, picture in drawn if draw(results, picture))]


def _interrupt(*_: Any) -> NoReturn:  # noqa: ANN401 - whatever a signal brings
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """Measure, print and save; 0 if all went well, 2 for bad options, 1 if a measurement fails, 130 if ended."""
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
    signal.signal(signal.SIGTERM, _interrupt)  # so that workers end and what was found is shown
    with Progress(*columns, console=console) as progress:
        try:
            measure(options, results, Log(progress, results, options.out))
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

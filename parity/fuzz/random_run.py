"""``python -m parity.fuzz.random_run``: compare the solver with the reference on random scenes."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from iphyre_jax import Scene
from parity.__main__ import PLAYS_A_TASK, REPORT_WIDTH, Rate, plain
from parity.compare import PlanComparison
from parity.divergences import Astray
from parity.fuzz.random_scenes import TEMPLATES, random_scene
from parity.fuzz.regressions import Case, write_case
from parity.fuzz.shrink import same_difference, shrink
from parity.play import DURATION, GameResult, Task, compare_games
from parity.reports.report import circumstances, save
from parity.reports.summary import summarise
from parity.reports.tables import LEGEND, Section, screen_table, verdict_line
from parity.reports.verdict import below
from parity.stages import Divergence
from parity.tolerances import RANDOM_SHARE, RANDOM_STEP


@dataclass(frozen=True)
class Options:
    """Random scenes x random plans x frame rates, in float64.

    What is done is kept beside the report; a run that was killed goes on where it was.

    Attributes:
        scenes: number of random scenes.
        plans: random plans a scene.
        fps: frame rates; each has tables of its own.
        resets: number of the reset to play in.
        seed: seed of scenes and plans.
        duration: seconds a play lasts.
        workers: processes that share the scenes.
        shrink: how many of the scenes that differ are made as small as they can be and saved as test cases.
        out: folder for the report.
        name: its file name without its ending.
    """

    scenes: int = 2000
    plans: int = 10
    fps: tuple[Rate, ...] = (60, 10)
    resets: int = 1
    seed: int = 0
    duration: float = DURATION
    workers: int = 2
    shrink: int = 0
    out: Path = field(default_factory=lambda: Path("parity") / "results")
    name: str = "random"


def tasks_of(options: Options) -> list[tuple[int, Task]]:
    """Scenes of one template share chunks; a task comes with the template's index, the costliest templates first."""
    size = max(1, PLAYS_A_TASK // options.plans)
    tasks = []
    for template in sorted(range(len(TEMPLATES)), key=lambda k: -TEMPLATES[k].moving):
        indices = range(template, options.scenes, len(TEMPLATES))
        for start in range(0, len(indices), size):
            scenes = tuple(random_scene(index, options.seed) for index in indices[start : start + size])
            around = options.fps, ("float64",), options.resets, options.seed
            tasks.append((template, Task(scenes, options.plans, *around, duration=options.duration, explained=1)))
    return tasks


def compare(options: Options, console: Console) -> list[tuple[int, GameResult]]:
    """Run the comparison with a progress bar; the results come with their templates, in the order of the tasks."""
    tasks = tasks_of(options)
    log = options.out / f"{options.name}.part.jsonl"
    found = dict(_done(log, options, tasks))
    left = [index for index in range(len(tasks)) if index not in found]
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress, log.open("a", encoding="utf-8") as file:
        bar = progress.add_task("scenes", total=options.scenes)
        progress.advance(bar, sum(len(tasks[index][1].scenes) for index in found))
        for place, results in compare_games(
            [tasks[index][1] for index in left], min(options.workers, max(len(left), 1))
        ):
            index = left[place]
            found[index] = results
            file.write(json.dumps({"task": index, "results": [_record(result) for result in results]}) + "\n")
            file.flush()
            progress.advance(bar, len(tasks[index][1].scenes))
    return [(tasks[index][0], result) for index in sorted(found) for result in found[index]]


def _key(options: Options) -> dict[str, Any]:
    """What decides the results: the options that matter, the commit and the engine."""
    chosen = {name: plain(getattr(options, name)) for name in ("scenes", "plans", "fps", "resets", "seed", "duration")}
    return chosen | {name: circumstances({})[name] for name in ("commit", "versions")}


def _done(log: Path, options: Options, tasks: list[tuple[int, Task]]) -> Iterator[tuple[int, list[GameResult]]]:
    """Read what an earlier run with the same options has done; begin a new file if there is none."""
    lines = log.read_text(encoding="utf-8").splitlines() if log.exists() else []
    key = _key(options)
    if not lines or json.loads(lines[0]) != key:
        log.parent.mkdir(parents=True, exist_ok=True)
        log.write_text(json.dumps(key) + "\n", encoding="utf-8")
        return
    for line in lines[1:]:
        try:
            record = json.loads(line)
        except ValueError:  # cut off in the middle
            continue
        scenes = {scene.name: scene for scene in tasks[record["task"]][1].scenes if isinstance(scene, Scene)}
        yield record["task"], [_result(told, scenes) for told in record["results"]]


def _record(result: GameResult) -> dict[str, Any]:
    """A result as JSON, without its course and pictures."""
    compared = {name: np.asarray(value).tolist() for name, value in vars(result.comparison).items() if name != "course"}
    return {
        "game": result.game,
        "fps": result.fps,
        "eliminate_at": result.eliminate_at.tolist(),
        "comparison": compared,
        "astray": [asdict(plan) for plan in result.astray],
    }


def _result(told: dict[str, Any], scenes: dict[str, Scene]) -> GameResult:
    compared = {name: np.array(value) for name, value in told["comparison"].items()}
    course = np.zeros((len(compared["error"]), 0), np.float32)
    return GameResult(
        scene=scenes[told["game"]],
        fps=told["fps"],
        dtype="float64",
        eliminate_at=np.array(told["eliminate_at"], np.int32).reshape(len(course), -1),
        comparison=PlanComparison(course=course, **compared),
        astray=tuple(_astray(plan) for plan in told["astray"]),
    )


def _astray(told: dict[str, Any]) -> Astray:
    found = {name: Divergence(**told[name]) if told[name] else None for name in ("first_bit", "first_stage")}
    pairs = {name: tuple(told[name]) for name in ("eliminate_at", "reference", "ours")}
    return Astray(**told | found | pairs)


def sections(results: list[tuple[int, GameResult]]) -> list[Section]:
    """One table a frame rate, one row a template."""
    made = []
    for fps in dict.fromkeys(result.fps for _, result in results):
        groups: dict[int, list[PlanComparison]] = {}
        for template, result in results:
            if result.fps == fps:
                groups.setdefault(template, []).append(result.comparison)
        rows = tuple(summarise(_name(template), groups[template]) for template in sorted(groups))
        overall = summarise("all", [comparison for group in groups.values() for comparison in group])
        missed = (
            below("plans within", "1e-06 px", overall.within(1e-6), RANDOM_SHARE),
            below("plans with", "the same success step", overall.same_step, RANDOM_STEP),
            below("plans with", "the same removals and objects", overall.same_bookkeeping, RANDOM_STEP),
        )
        made.append(Section(fps, "float64", rows, overall, (), tuple(filter(None, missed))))
    return made


def _name(template: int) -> str:
    """A template in words."""
    t = TEMPLATES[template]
    words = [f"{count} {name}{'s' * (count > 1)}" for count, name in ((t.bars, "bar"), (t.balls, "ball")) if count]
    words += [
        f"{len(ends)} {name}{'s' * (len(ends) > 1)}"
        for ends, name in ((t.joints, "joint"), (t.springs, "spring"))
        if ends
    ]
    return f"{template}: {', '.join(words)}"


def shrunk(options: Options, results: list[tuple[int, GameResult]], console: Console) -> None:
    """Make small cases of the first scenes that differ, one a scene, and save them."""
    chosen: dict[str, tuple[GameResult, Astray]] = {}
    for _, result in results:
        if result.astray:
            chosen.setdefault(result.game, (result, result.astray[0]))
    for result, plan in list(chosen.values())[: options.shrink]:
        row, fps = np.array(plan.eliminate_at, np.int32), result.fps
        given = {"fps": fps, "steps": round(options.duration * fps), "resets": options.resets}
        scene, rows = shrink(result.scene, row, same_difference(result.scene, row, **given))
        case = Case(scene, tuple(rows.tolist()), fps, options.resets, str(plan.first_bit))
        path = write_case(options.out / "cases", case)
        console.print(f"{result.game}: {scene.n_objects} objects, {path}", highlight=False, soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Run, print and save; 0 if every target is reached, 1 if not, 2 for bad options."""
    options = tyro.cli(Options, args=arguments, prog="python -m parity.fuzz.random_run")
    console = Console(width=None if sys.stdout.isatty() else REPORT_WIDTH)
    for name, least in (("scenes", 1), ("plans", 1), ("resets", 1), ("workers", 1), ("seed", 0), ("shrink", 0)):
        if getattr(options, name) < least:
            print(f"--{name}: expected an integer of at least {least}, got {getattr(options, name)}", file=sys.stderr)
            return 2
    around = circumstances({name: plain(value) for name, value in asdict(options).items()})  # the commit that now runs
    results = compare(options, console)
    made = sections(results)
    save(options.out, options.name, made, [result for _, result in results], around, page_too=False)
    for section in made:
        console.print(screen_table(section))
    console.print(LEGEND, highlight=False)
    for section in made:
        console.print(verdict_line(section), highlight=False, soft_wrap=True)
    shrunk(options, results, console)
    console.print(f"saved as {options.out / options.name}.md and .json", highlight=False, soft_wrap=True)
    return int(any(section.missed for section in made))


if __name__ == "__main__":
    sys.exit(main())

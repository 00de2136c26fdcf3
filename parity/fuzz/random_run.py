"""``python -m parity.fuzz.random_run``: compare the solver with the reference on random scenes."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console

from iphyre_jax import Scene
from iphyre_jax.execution.compilation.description import source_sums
from iphyre_jax.files import replace_text
from iphyre_jax.memory import check_memory
from parity.__main__ import BYTES_OF_PLAN, PLAYS_A_TASK, Rate
from parity.command import (
    options_as_json,
    progress_bar,
    report_console,
    require_at_least,
    require_output,
    require_rates,
    require_steps,
)
from parity.compare import PlanComparison
from parity.divergences import DivergedPlan
from parity.fuzz.random_scenes import TEMPLATES, random_scene
from parity.fuzz.regressions import Case, write_case
from parity.fuzz.shrink import same_difference, shrink
from parity.play import DURATION, GameResult, Task, compare_games
from parity.reports.report import publish, run_info
from parity.reports.summary import summarise
from parity.reports.tables import Section
from parity.reports.targets_met import shortfall
from parity.stages import Divergence
from parity.tolerances import RANDOM_SHARE, RANDOM_STEP

PARITY = Path(__file__).parents[1]


@dataclass(frozen=True)
class Options:
    """Random scenes x random plans x frame rates, in float64.

    Finished tasks are kept beside the report until it is written, so that a killed run continues where it stopped.

    Attributes:
        scenes: random scenes.
        plans: random plans a scene.
        fps: frame rates; each has tables of its own.
        resets: number of the reset to play in.
        seed: seed of scenes and plans.
        duration: seconds of a play.
        workers: processes among which the scenes are shared.
        shrink: how many of the scenes that differ to make as small as possible and save as test cases.
        out: folder of the report.
        name: of its files, without the ending.
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
    """Tasks with the index of their template, the costliest templates first; scenes of a template share chunks."""
    size = max(1, PLAYS_A_TASK // options.plans)
    tasks = []
    for template in sorted(range(len(TEMPLATES)), key=lambda k: -TEMPLATES[k].moving):
        indices = range(template, options.scenes, len(TEMPLATES))
        for start in range(0, len(indices), size):
            scenes = tuple(random_scene(index, options.seed) for index in indices[start : start + size])
            settings = options.fps, ("float64",), options.resets, options.seed
            tasks.append((template, Task(scenes, options.plans, *settings, duration=options.duration, explained=1)))
    return tasks


def compare(options: Options, console: Console) -> list[tuple[int, GameResult]]:
    """Run the comparison and show its progress; return results with their templates, in the order of the tasks."""
    tasks = tasks_of(options)
    log = _log(options)
    finished = dict(_done(log, options, tasks))
    left = [index for index in range(len(tasks)) if index not in finished]
    with progress_bar(console) as progress, log.open("a", encoding="utf-8") as file:
        bar = progress.add_task("scenes", total=options.scenes)
        progress.advance(bar, sum(len(tasks[index][1].scenes) for index in finished))
        for place, results in compare_games(
            [tasks[index][1] for index in left], min(options.workers, max(len(left), 1))
        ):
            index = left[place]
            finished[index] = results
            file.write(json.dumps({"task": index, "results": [_record(result) for result in results]}) + "\n")
            file.flush()
            progress.advance(bar, len(tasks[index][1].scenes))
    return [(tasks[index][0], result) for index in sorted(finished) for result in finished[index]]


def _log(options: Options) -> Path:
    """The file of finished tasks."""
    return options.out / f"{options.name}.part.jsonl"


def _key(options: Options) -> dict[str, Any]:
    """What decides the results: some options, the code of solver and comparison, the versions."""
    kept = "scenes", "plans", "fps", "resets", "seed", "duration"
    chosen = {name: value for name, value in options_as_json(options).items() if name in kept}
    return chosen | {"code": _code_sum(), "versions": run_info({})["versions"]}


def _code_sum() -> str:
    """SHA-256 of all code of the package and of this comparison as it is now; a commit does not know of edits."""
    return hashlib.sha256(repr((source_sums(), source_sums(PARITY))).encode()).hexdigest()


def _done(log: Path, options: Options, tasks: list[tuple[int, Task]]) -> Iterator[tuple[int, list[GameResult]]]:
    """Read the results of an earlier run with the same options and code; begin a new file if there is none.

    A kill leaves at most the last line cut off; it goes, so that the next one is whole.
    """
    key = json.dumps(_key(options))
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True) if log.exists() else []
    whole = [line for line in lines if line.endswith("\n")]
    own = whole if whole[:1] == [key + "\n"] else [key + "\n"]
    replace_text(log, "".join(own))
    for record in map(json.loads, own[1:]):
        scenes = {scene.name: scene for scene in tasks[record["task"]][1].scenes if isinstance(scene, Scene)}
        yield record["task"], [_result(data, scenes) for data in record["results"]]


def _record(result: GameResult) -> dict[str, Any]:
    """A result as JSON, without its errors over time and pictures."""
    arrays = vars(result.comparison).items()
    compared = {name: np.asarray(value).tolist() for name, value in arrays if name != "error_over_time"}
    return {
        "game": result.game,
        "fps": result.fps,
        "eliminate_at": result.eliminate_at.tolist(),
        "comparison": compared,
        "diverged": [asdict(plan) for plan in result.diverged],
    }


def _result(data: dict[str, Any], scenes: dict[str, Scene]) -> GameResult:
    compared = {name: np.array(value) for name, value in data["comparison"].items()}
    error_over_time = np.zeros((len(compared["error"]), 0), np.float32)
    return GameResult(
        scene=scenes[data["game"]],
        fps=data["fps"],
        dtype="float64",
        eliminate_at=np.array(data["eliminate_at"], np.int32).reshape(len(error_over_time), -1),
        comparison=PlanComparison(error_over_time=error_over_time, **compared),
        diverged=tuple(_diverged_plan(plan) for plan in data["diverged"]),
    )


def _diverged_plan(data: dict[str, Any]) -> DivergedPlan:
    stages = {name: Divergence(**data[name]) if data[name] else None for name in ("first_bit", "first_stage")}
    pairs = {name: tuple(data[name]) for name in ("eliminate_at", "reference", "ours")}
    return DivergedPlan(**data | stages | pairs)


def sections(results: list[tuple[int, GameResult]]) -> list[Section]:
    """One table a frame rate, one row a template."""
    tables = []
    for fps in dict.fromkeys(result.fps for _, result in results):
        groups: dict[int, list[PlanComparison]] = {}
        for template, result in results:
            if result.fps == fps:
                groups.setdefault(template, []).append(result.comparison)
        rows = tuple(summarise(_title(template), groups[template]) for template in sorted(groups))
        overall = summarise("all", [comparison for group in groups.values() for comparison in group])
        missed = (
            shortfall("plans within", "1e-06 px", overall.within(1e-6), RANDOM_SHARE),
            shortfall("plans with", "the same success step", overall.same_step, RANDOM_STEP),
            shortfall("plans with", "the same removals and objects", overall.same_bookkeeping, RANDOM_STEP),
        )
        tables.append(Section(fps, "float64", rows, overall, (), tuple(filter(None, missed))))
    return tables


def _title(template: int) -> str:
    """A template in words."""
    t = TEMPLATES[template]
    counts = ((t.bars, "bar"), (t.balls, "ball"), (len(t.joints), "joint"), (len(t.springs), "spring"))
    words = [f"{count} {name}{'s' * (count > 1)}" for count, name in counts if count]
    return f"{template}: {', '.join(words)}"


def save_small_cases(options: Options, results: list[tuple[int, GameResult]], console: Console) -> None:
    """Shrink the first scenes that differ and save them as test cases."""
    chosen: dict[str, tuple[GameResult, DivergedPlan]] = {}
    for _, result in results:
        if result.diverged:
            chosen.setdefault(result.game, (result, result.diverged[0]))
    for result, plan in list(chosen.values())[: options.shrink]:
        row, fps = np.array(plan.eliminate_at, np.int32), result.fps
        timing = {"fps": fps, "steps": round(options.duration * fps), "resets": options.resets}
        try:
            scene, rows = shrink(result.scene, row, same_difference(result.scene, row, **timing))
        except ValueError as error:  # stepped alone it shows no difference
            console.print(f"{result.game}: {error}", highlight=False, soft_wrap=True)
            continue
        case = Case(scene, tuple(rows.tolist()), fps, options.resets, str(plan.first_bit))
        path = write_case(options.out / "cases", case)
        console.print(f"{result.game}: {scene.n_objects} objects, {path}", highlight=False, soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Run, print and save; return 0 if every target is met, 1 if not, 2 for bad options, 130 if interrupted."""
    options = tyro.cli(Options, args=arguments, prog="python -m parity.fuzz.random_run")
    console = report_console()
    try:
        require_at_least(options, scenes=1, plans=1, resets=1, workers=1, seed=0, shrink=0)
        check_memory("--plans", BYTES_OF_PLAN * options.plans, "compare fewer plans")
        require_rates(options.fps, options.duration)
        for index in range(min(options.scenes, len(TEMPLATES))):
            require_steps(random_scene(index, options.seed), options.fps, options.duration)
        require_output(options.out, options.name)
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    info = run_info(options_as_json(options))  # before the run, so that it names the commit that runs
    try:
        results = compare(options, console)
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        return 130
    games = [result for _, result in results]
    code = publish(options.out, options.name, sections(results), games, info, console, with_page=False)
    save_small_cases(options, results, console)
    _log(options).unlink()
    return code


if __name__ == "__main__":
    sys.exit(main())

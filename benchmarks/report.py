"""The tables and the JSON of a run."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import iphyre_jax
from benchmarks.decision_rate import Deciding
from benchmarks.engines import STEPPING
from benchmarks.measure import Measurement, ratio
from benchmarks.scaling_batch import Scale
from benchmarks.scaling_size import Growth
from benchmarks.startup import Startup
from benchmarks.workload import MIXED
from iphyre_jax.execution.configuration import usable_cores
from iphyre_jax.provenance import CORE, processor, source_commit, versions

SCHEMA = 2  # of the JSON file
QUIET = 0.5  # load below which the machine counts as idle


@dataclass
class Results:
    """What a run has found so far.

    Attributes:
        around: what a reader needs to repeat it.
        problems: what could not be measured, one line each.
        engines: what each engine is made of.
        measurements: engines on works.
        startups: times to a first result.
        growths: speed by objects, moving bodies and steps.
        scales: speed by batch and players.
        bytes_a_world: carried state by game and type.
        decisions: decisions on the fly beside plain simulation.
    """

    around: dict[str, Any]
    problems: list[str] = field(default_factory=list)
    engines: dict[str, dict[str, Any]] = field(default_factory=dict)
    measurements: list[Measurement] = field(default_factory=list)
    startups: list[Startup] = field(default_factory=list)
    growths: list[Growth] = field(default_factory=list)
    scales: list[Scale] = field(default_factory=list)
    bytes_a_world: dict[str, dict[str, int]] = field(default_factory=dict)
    decisions: list[Deciding] = field(default_factory=list)

    def of(self, work: str, fps: int) -> dict[str, Measurement]:
        """The measurements of one work by engine."""
        return {one.engine: one for one in self.measurements if (one.work, one.fps) == (work, fps)}

    def rates(self) -> list[int]:
        """The frame rates that were measured."""
        return list(dict.fromkeys(one.fps for one in self.measurements))


def circumstances(options: Mapping[str, Any]) -> dict[str, Any]:
    """Machine, versions, commit and options."""
    return {
        "machine": {
            "system": platform.platform(),
            "processor": processor(),
            "cores": usable_cores(),
            "load": os.getloadavg()[0],  # processes that wanted a core in the minute before the start
        },
        "versions": versions((*CORE, "pymunk")),
        "commit": source_commit(),
        "options": dict(options),
    }


def disturbance(around: Mapping[str, Any]) -> list[str]:
    """Say so if the machine was busy with something else when the run began."""
    load = around["machine"]["load"]
    if load <= QUIET:
        return []
    return [
        f"the machine was busy at the start (load {load:.1f}): ratios are worth more than figures, and less than usual"
    ]


def as_json(results: Results) -> str:
    """The whole run as JSON."""
    document = {
        "schema": SCHEMA,
        **results.around,
        "problems": results.problems,
        "engines": results.engines,
        "measurements": [_row(one) for one in results.measurements],
        "startups": [asdict(one) for one in results.startups],
        "growths": [{"what": one.what, "size": one.size, **_row(one.measured)} for one in results.growths],
        "scales": [{"batch": one.batch, "players": one.players, **_row(one.measured)} for one in results.scales],
        "bytes_a_world": results.bytes_a_world,
        "decisions": [asdict(one) for one in results.decisions],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _row(one: Measurement) -> dict[str, Any]:
    spread = {"median": one.rate, "low": min(one.rates), "high": max(one.rates)}
    return {**asdict(one), "compile_seconds": one.compile_seconds, "steps_per_second": spread}


def show(results: Results, console: Console) -> None:
    """Print every table that the run has something for."""
    for fps in results.rates():
        if mixture := results.of(MIXED, fps):
            console.print(mixture_table(mixture, fps))
        if games := [game for game in iphyre_jax.GAMES if results.of(game, fps)]:
            console.print(game_table(results, games, fps))
    if results.startups:
        console.print(startup_table(results.startups))
    if results.growths:
        console.print(growth_table(results.growths))
    if results.scales:
        console.print(scaling_table(results.scales))
    if results.bytes_a_world:
        console.print(bytes_table(results.bytes_a_world))
    for fps in dict.fromkeys(one.fps for one in results.decisions):
        console.print(deciding_table([one for one in results.decisions if one.fps == fps], fps))
    for problem in results.problems:
        console.print(problem, highlight=False)


def table(title: str, *columns: str) -> Table:
    """An empty table whose first column is text."""
    made = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), min_width=len(title))
    for k, column in enumerate(columns):
        made.add_column(column, justify="right" if k else "left", no_wrap=k == 0)
    return made


def mixture_table(mixture: Mapping[str, Measurement], fps: int) -> Table:
    """All engines on all games in equal parts."""
    title = f"Games mixed, {fps} fps: million steps a second"
    made = table(title, "engine", "median", "spread", "x pymunk", "same step", "solved", "compile s", "episodes")
    base = mixture.get(STEPPING)
    for name, one in mixture.items():
        made.add_row(
            name,
            millions(one.rate),
            f"{millions(min(one.rates))} - {millions(max(one.rates))}",
            f"{ratio(one, base):.3g}" if base else "-",
            f"{100 * one.same_steps:.1f} %",
            f"{100 * one.solved:.1f} %",
            f"{one.compile_seconds:.1f}",
            str(one.episodes),
        )
    return made


def game_table(results: Results, games: Sequence[str], fps: int) -> Table:
    """Every game: steps a second of all engines, and how many times pymunk's."""
    names = list(dict.fromkeys(name for game in games for name in results.of(game, fps)))
    ours = [name for name in names if name.startswith("iphyre_jax")]
    ratios = [f"{name.removeprefix('iphyre_jax ')} x pymunk" for name in ours]
    made = table(f"Game by game, {fps} fps: million steps a second", "game", "moving", *names, *ratios)
    for game in games:
        found = results.of(game, fps)
        cells = [millions(found[name].rate) if name in found else "-" for name in names]
        times = [f"{ratio(found[n], found[STEPPING]):.3g}" if {n, STEPPING} <= found.keys() else "-" for n in ours]
        made.add_row(game, str(int(iphyre_jax.load_scene(game).dynamic.sum())), *cells, *times)
    return made


def startup_table(startups: Sequence[Startup]) -> Table:
    """Seconds from the start of a process to its first result."""
    title = f"Seconds from process start to the first result, float32, {startups[0].batch} worlds"
    made = table(title, "games", "moving", "empty cache", "CPU s", "warm cache", "CPU s")
    for one in startups:
        pairs = zip((one.empty, one.warm), one.processor, strict=True)
        made.add_row(one.work, str(one.moving), *(f"{seconds:.1f}" for pair in pairs for seconds in pair))
    return made


def growth_table(growths: Sequence[Growth]) -> Table:
    """What a step costs as scenes and episodes grow."""
    made = table(
        "Balls at rest on fixed bars, 10 fps, float32", "grows", "size", "million steps a second", "CPU ns a step"
    )
    for one in growths:
        made.add_row(one.what, str(one.size), millions(one.measured.rate), f"{1e9 * one.measured.step_cost:.3g}")
    return made


def scaling_table(scales: Sequence[Scale]) -> Table:
    """Million steps a second by batch and players, beside the first player, and the last one's memory."""
    first, *others = dict.fromkeys(one.players for one in scales)
    heads = [head for name in others for head in (name, f"x {first}")]
    made = table("Games mixed, 10 fps, float32: million steps a second", "batch", first, *heads, "CPU ns a step", "MB")
    for batch in dict.fromkeys(one.batch for one in scales):
        by = {one.players: one.measured for one in scales if one.batch == batch}
        cells = [cell for n in others for cell in (millions(by[n].rate), f"{ratio(by[n], by[first]):.2f}")]
        last = by[(first, *others)[-1]]
        made.add_row(
            str(batch), millions(by[first].rate), *cells, f"{1e9 * last.step_cost:.3g}", f"{last.memory / 1e6:.0f}"
        )
    return made


def bytes_table(sizes: Mapping[str, Mapping[str, int]]) -> Table:
    """Bytes that a world carries from step to step; games of one layout together."""
    made = table("Carried state, bytes a world", "float32", "float64", "moving", "objects", "games")
    layouts: dict[tuple[int, int, int], list[str]] = {}
    for game, by in sizes.items():
        moving = int(iphyre_jax.load_scene(game).dynamic.sum())
        layouts.setdefault((by["float32"], by["float64"], moving), []).append(game)
    for (single, double, moving), games in sorted(layouts.items()):
        objects = [iphyre_jax.load_scene(game).n_objects for game in games]
        span = f"{min(objects)} - {max(objects)}" if min(objects) < max(objects) else str(objects[0])
        made.add_row(str(single), str(double), str(moving), span, ", ".join(games))
    made.columns[-1].justify = "left"
    return made


def deciding_table(found: Sequence[Deciding], fps: int) -> Table:
    """Physics steps a second under decisions on the fly; wall and cpu: as a share of plain simulation's."""
    heads = ["simulate", *(f"{what} {clock}" for what in ("scan", "read", "kept") for clock in ("M/s", "wall", "cpu"))]
    made = table(
        f"On the fly, {fps} fps, float32: env.step in a scan; unroll, observations read, or kept too",
        "games",
        *heads,
        "same step",
        "compile s",
    )
    for one in found:
        cells = [
            cell
            for name in ("scan", "reads", "keeps")
            for cell in (millions(one.rate(name, 0)), f"{one.share(name, 0):.2f}", f"{one.share(name, 1):.2f}")
        ]
        made.add_row(
            one.work, millions(one.rate("simulate", 0)), *cells, f"{100 * one.same_steps:.1f} %", f"{one.compiled:.1f}"
        )
    return made


def millions(rate: float) -> str:
    """Steps a second in millions, three digits."""
    return f"{rate / 1e6:.3g}"

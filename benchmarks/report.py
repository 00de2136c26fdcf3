"""The tables and the JSON of a run."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

import iphyre_jax
from benchmarks.decision_rate import DecisionRate
from benchmarks.engines import STEPPING
from benchmarks.measure import Measurement, ratio
from benchmarks.scaling import BatchScaling, SizeScaling
from benchmarks.startup import Startup
from benchmarks.workload import MIXED
from iphyre_jax.provenance import CORE, machine, source_commit, versions

SCHEMA = 3  # of the JSON file
MAX_IDLE_LOAD = 0.5  # a machine with a higher load counts as busy


@dataclass
class Results:
    """The results of a run so far.

    Attributes:
        info: what a reader needs to repeat the run.
        problems: one line for each thing that could not be measured.
        engines: processes and versions of each engine.
        measurements: engines on workloads.
        startups: times to a first result.
        scaling_size: speed by objects, moving bodies and steps.
        scaling_batch: speed by batch and players.
        bytes_a_world: carried state by game and type.
        decisions: decisions on the fly beside plain simulation.
    """

    info: dict[str, Any]
    problems: list[str] = field(default_factory=list)
    engines: dict[str, dict[str, Any]] = field(default_factory=dict)
    measurements: list[Measurement] = field(default_factory=list)
    startups: list[Startup] = field(default_factory=list)
    scaling_size: list[SizeScaling] = field(default_factory=list)
    scaling_batch: list[BatchScaling] = field(default_factory=list)
    bytes_a_world: dict[str, dict[str, int]] = field(default_factory=dict)
    decisions: list[DecisionRate] = field(default_factory=list)

    def by_engine(self, workload: str, fps: int) -> dict[str, Measurement]:
        """The measurements of one workload by engine."""
        return {one.engine: one for one in self.measurements if (one.workload, one.fps) == (workload, fps)}

    def frame_rates(self) -> list[int]:
        """The measured frame rates."""
        return list(dict.fromkeys(one.fps for one in self.measurements))


def run_info(options: Mapping[str, Any]) -> dict[str, Any]:
    """Machine, versions, commit and options."""
    return {
        # Load: processes that wanted a core in the minute before the start.
        "machine": {**machine(), "load": os.getloadavg()[0]},
        "versions": versions((*CORE, "pymunk")),
        "commit": source_commit(),
        "options": dict(options),
    }


def load_warnings(info: Mapping[str, Any]) -> list[str]:
    """A line if the machine was busy when the run began."""
    load = info["machine"]["load"]
    if load <= MAX_IDLE_LOAD:
        return []
    return [f"the machine was busy at the start (load {load:.1f}): trust ratios more than absolute figures"]


def as_json(results: Results) -> str:
    """The whole run as JSON."""
    document = {
        "schema": SCHEMA,
        **results.info,
        "problems": results.problems,
        "engines": results.engines,
        "measurements": [_row(one) for one in results.measurements],
        "startups": [asdict(one) for one in results.startups],
        "scaling_size": [{"what": one.what, "size": one.size, **_row(one.measured)} for one in results.scaling_size],
        "scaling_batch": [
            {"batch": one.batch, "players": one.players, **_row(one.measured)} for one in results.scaling_batch
        ],
        "bytes_a_world": results.bytes_a_world,
        "decisions": [asdict(one) for one in results.decisions],
    }
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def _row(one: Measurement) -> dict[str, Any]:
    spread = {"median": one.rate, "low": min(one.rates), "high": max(one.rates)}
    return {**asdict(one), "compile_seconds": one.compile_seconds, "steps_per_second": spread}


def show(results: Results, console: Console) -> None:
    """Print every table that has data."""
    for fps in results.frame_rates():
        if mixture := results.by_engine(MIXED, fps):
            console.print(mixture_table(mixture, fps))
        if games := [game for game in iphyre_jax.GAMES if results.by_engine(game, fps)]:
            console.print(game_table(results, games, fps))
    if results.startups:
        console.print(startup_table(results.startups))
    if results.scaling_size:
        console.print(size_table(results.scaling_size))
    if results.scaling_batch:
        console.print(batch_table(results.scaling_batch))
    if results.bytes_a_world:
        console.print(bytes_table(results.bytes_a_world))
    for fps in dict.fromkeys(one.fps for one in results.decisions):
        console.print(decision_table([one for one in results.decisions if one.fps == fps], fps))
    for problem in results.problems:
        console.print(problem, highlight=False)


def table(title: str, *columns: str) -> Table:
    """An empty table whose first column is text."""
    grid = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1, 0, 0), min_width=len(title))
    for k, column in enumerate(columns):
        grid.add_column(column, justify="right" if k else "left", no_wrap=k == 0)
    return grid


def mixture_table(mixture: Mapping[str, Measurement], fps: int) -> Table:
    """All engines on the mixture of games."""
    title = f"Games mixed, {fps} fps: million steps a second"
    grid = table(title, "engine", "median", "spread", "x pymunk", "same step", "solved", "compile s", "episodes")
    base = mixture.get(STEPPING)
    for name, one in mixture.items():
        grid.add_row(
            name,
            millions(one.rate),
            f"{millions(min(one.rates))} - {millions(max(one.rates))}",
            f"{ratio(one, base):.3g}" if base else "-",
            f"{100 * one.same_steps:.1f} %",
            f"{100 * one.solved:.1f} %",
            f"{one.compile_seconds:.1f}",
            str(one.episodes),
        )
    return grid


def game_table(results: Results, games: Sequence[str], fps: int) -> Table:
    """Every game: steps a second of all engines, and ours as multiples of pymunk's."""
    names = list(dict.fromkeys(name for game in games for name in results.by_engine(game, fps)))
    ours = [name for name in names if name.startswith("iphyre_jax")]
    ratios = [f"{name.removeprefix('iphyre_jax ')} x pymunk" for name in ours]
    grid = table(f"Game by game, {fps} fps: million steps a second", "game", "moving", *names, *ratios)
    for game in games:
        found = results.by_engine(game, fps)
        cells = [millions(found[name].rate) if name in found else "-" for name in names]
        times = [f"{ratio(found[n], found[STEPPING]):.3g}" if {n, STEPPING} <= found.keys() else "-" for n in ours]
        grid.add_row(game, str(int(iphyre_jax.load_scene(game).dynamic.sum())), *cells, *times)
    return grid


def startup_table(startups: Sequence[Startup]) -> Table:
    """Seconds from the start of a process to its first result."""
    title = f"Seconds from process start to the first result, float32, {startups[0].batch} worlds"
    grid = table(title, "games", "moving", "empty cache", "CPU s", "warm cache", "CPU s")
    for one in startups:
        pairs = zip((one.empty, one.warm), one.processor, strict=True)
        grid.add_row(one.workload, str(one.moving), *(f"{seconds:.1f}" for pair in pairs for seconds in pair))
    return grid


def size_table(scaling_size: Sequence[SizeScaling]) -> Table:
    """The cost of a step as scenes and episodes grow."""
    grid = table(
        "Balls at rest on fixed bars, 10 fps, float32", "grows", "size", "million steps a second", "CPU ns a step"
    )
    for one in scaling_size:
        grid.add_row(one.what, str(one.size), millions(one.measured.rate), f"{1e9 * one.measured.step_cost:.3g}")
    return grid


def batch_table(scaling_batch: Sequence[BatchScaling]) -> Table:
    """Steps a second by batch and players, as multiples of the first players' too, and the last players' memory."""
    first, *others = dict.fromkeys(one.players for one in scaling_batch)
    heads = [head for name in others for head in (name, f"x {first}")]
    grid = table("Games mixed, 10 fps, float32: million steps a second", "batch", first, *heads, "CPU ns a step", "MB")
    for batch in dict.fromkeys(one.batch for one in scaling_batch):
        by = {one.players: one.measured for one in scaling_batch if one.batch == batch}
        cells = [cell for n in others for cell in (millions(by[n].rate), f"{ratio(by[n], by[first]):.2f}")]
        last = by[(first, *others)[-1]]
        grid.add_row(
            str(batch), millions(by[first].rate), *cells, f"{1e9 * last.step_cost:.3g}", f"{last.memory / 1e6:.0f}"
        )
    return grid


def bytes_table(sizes: Mapping[str, Mapping[str, int]]) -> Table:
    """Bytes that a world carries from step to step; games of equal size share a row."""
    grid = table("Carried state, bytes a world", "float32", "float64", "moving", "objects", "games")
    layouts: dict[tuple[int, int, int], list[str]] = {}
    for game, by in sizes.items():
        moving = int(iphyre_jax.load_scene(game).dynamic.sum())
        layouts.setdefault((by["float32"], by["float64"], moving), []).append(game)
    for (single, double, moving), games in sorted(layouts.items()):
        objects = [iphyre_jax.load_scene(game).n_objects for game in games]
        span = f"{min(objects)} - {max(objects)}" if min(objects) < max(objects) else str(objects[0])
        grid.add_row(str(single), str(double), str(moving), span, ", ".join(games))
    grid.columns[-1].justify = "left"
    return grid


def decision_table(found: Sequence[DecisionRate], fps: int) -> Table:
    """Physics steps a second with decisions on the fly, and as a share of plain simulation's."""
    variants = "scan", "xla", "spread", "reads", "keeps"
    loops = 'env.step in a scan, with backend="xla", and spread over devices'
    title = f"On the fly, {fps} fps, float32: {loops}; unroll that reads, or also keeps, observations"
    heads = [f"{name} {unit}" for name in variants for unit in ("M/s", "share")]
    grid = table(title, "games", "simulate", *heads, "same step", "compile s")
    for one in found:
        cells = [one.workload, millions(one.rate("simulate"))]
        for name in variants:
            cells += [millions(one.rate(name)), f"{one.share(name):.2f}"]
        compiled = "/".join(f"{one.compiled[name]:.1f}" for name in ("scan", "xla"))
        grid.add_row(*cells, f"{100 * one.same_steps:.1f} %", compiled)
    return grid


def millions(rate: float) -> str:
    """Steps a second in millions, three digits."""
    return f"{rate / 1e6:.3g}"

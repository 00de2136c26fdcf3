"""The bar chart of the engines, the scaling plots, and agents with and without predictions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import iphyre_jax
from benchmarks.engines import FLOAT32, FLOAT64, STEPPING
from benchmarks.report import Results
from benchmarks.workload import MIXED
from iphyre_jax.train.reports.compare import Row
from iphyre_jax.train.reports.report import TITLES

GREY, BLUE, LIGHT = "0.6", "tab:blue", "tab:cyan"
COLOURS = {FLOAT32: BLUE, FLOAT64: LIGHT}
COLUMNS = 3  # of panels
RESOLUTION = 150  # dots an inch


def predictions(agents: Mapping[str, Mapping[str, Row]], file: Path) -> None:
    """Draw a panel for each agent: its sampled reward by what it sees, on basic and on all forty games."""
    figure, panels = _panels(len(agents), 3.0, 2.8, sharey=True)
    for axes, (agent, rows) in zip(panels, agents.items(), strict=True):
        for split, colour in (("basic", BLUE), ("all", "tab:orange")):
            found = {name: value for name, row in rows.items() if (value := row.summary("sampled", split))}
            middle = [value.mean for value in found.values()]
            low, high = ([getattr(value, end) for value in found.values()] for end in ("low", "high"))
            ends = [np.nan_to_num(np.subtract(middle, low)), np.nan_to_num(np.subtract(high, middle))]
            axes.errorbar(list(found), middle, ends, fmt="o", capsize=3, color=colour, label=TITLES[split])
        axes.set(title=agent)
        axes.tick_params(axis="x", rotation=60)
        axes.grid(axis="y", alpha=0.3)
    panels[0].legend()
    figure.supylabel("mean reward, sampled actions")
    figure.savefig(file, dpi=RESOLUTION)


def bars(results: Results, file: Path) -> bool:
    """Draw steps a second of every engine on the mixture, on a logarithmic axis; False without data."""
    frame_rates = [fps for fps in results.frame_rates() if results.by_engine(MIXED, fps)]
    if not frame_rates:
        return False
    figure = Figure(figsize=(8, 0.9 + 2.4 * len(frame_rates)), layout="constrained")
    for axes, fps in zip(figure.subplots(len(frame_rates), squeeze=False)[:, 0], frame_rates, strict=True):
        _bars(axes, results, fps)
    figure.savefig(file, dpi=RESOLUTION)
    return True


def _bars(axes: Axes, results: Results, fps: int) -> None:
    found = list(results.by_engine(MIXED, fps).values())[::-1]
    middle = [one.rate for one in found]
    ends = [[one.rate - min(one.rates) for one in found], [max(one.rates) - one.rate for one in found]]
    colours = [COLOURS.get(one.engine, GREY) for one in found]
    drawn = axes.barh([one.engine for one in found], middle, xerr=ends, color=colours, capsize=3)
    axes.bar_label(drawn, [f"{rate:,.0f}" for rate in middle], padding=6)
    axes.set(xscale="log", xlabel="steps a second", title=f"Games mixed, {fps} fps, {_machine(results)}")
    axes.set_xlim(min(middle) / 3, max(middle) * 8)


def scaling(results: Results, file: Path) -> bool:
    """Draw speed over batch, the cost of a step over sizes, and each game's speed; False without data."""
    panels = [_batches] if results.scaling_batch else []
    panels += [partial(_sizes, what=what) for what in dict.fromkeys(one.what for one in results.scaling_size)]
    panels += [_games] if any(one.workload != MIXED for one in results.measurements) else []
    if not panels:
        return False
    figure, places = _panels(len(panels), 5.2, 4.0)
    for axes, draw in zip(places, panels, strict=True):
        draw(axes, results)
        axes.legend()
    figure.suptitle(_machine(results))
    figure.savefig(file, dpi=RESOLUTION)
    return True


def _panels(count: int, width: float, height: float, *, sharey: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of some panels, at most COLUMNS beside each other; width and height of each in inches."""
    rows, columns = -(-count // COLUMNS), min(COLUMNS, count)
    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    places = list(figure.subplots(rows, columns, sharey=sharey, squeeze=False).flat)
    for axes in places[count:]:
        axes.remove()
    return figure, places[:count]


def _batches(axes: Axes, results: Results) -> None:
    for players in dict.fromkeys(one.players for one in results.scaling_batch):
        found = [one for one in results.scaling_batch if one.players == players]
        rates = [one.measured.rate for one in found]
        axes.plot([one.batch for one in found], rates, marker="o", label=players)
    axes.set(xscale="log", xlabel="worlds in a call", ylabel="steps a second", title="Games mixed, 10 fps, float32")
    axes.set_ylim(bottom=0)


def _sizes(axes: Axes, results: Results, what: str) -> None:
    found = [one for one in results.scaling_size if one.what == what]
    costs = [1e9 * one.measured.step_cost for one in found]
    axes.plot([one.size for one in found], costs, marker="o", color=BLUE, label="processor ns a step")
    axes.set(xscale="log" if what == "steps" else "linear", xlabel=what, title="Balls at rest on bars, float32")
    axes.set_ylim(bottom=0)


def _games(axes: Axes, results: Results) -> None:
    fps = results.frame_rates()[0]
    for name, colour, shift in ((STEPPING, GREY, -0.1), (FLOAT64, LIGHT, 0.0), (FLOAT32, BLUE, 0.1)):
        found = [one for one in results.measurements if (one.engine, one.fps) == (name, fps) and one.workload != MIXED]
        moving = [iphyre_jax.load_scene(one.workload).dynamic.sum() + shift for one in found]
        axes.scatter(moving, [one.rate for one in found], s=14, color=colour, label=name)
    axes.set(
        yscale="log",
        xlim=(0.5, 6.5),
        xticks=range(1, 7),
        xlabel="moving bodies",
        ylabel="steps a second",
        title=f"Game by game, {fps} fps",
    )


def _machine(results: Results) -> str:
    machine = results.info["machine"]
    return f"{machine['processor']}, {machine['cores']} cores"

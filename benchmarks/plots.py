"""The bar chart and the scaling plot."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

import iphyre_jax
from benchmarks.engines import FLOAT32, FLOAT64, STEPPING
from benchmarks.report import Results
from benchmarks.work import MIXED

GREY, BLUE, LIGHT = "0.6", "tab:blue", "tab:cyan"
COLOURS = {FLOAT32: BLUE, FLOAT64: LIGHT}
RESOLUTION = 150  # dots an inch


def bars(results: Results, file: Path) -> bool:
    """Draw steps a second of every engine on the mixture, on a logarithmic axis; False if there is nothing to draw."""
    rates = [fps for fps in results.rates() if results.of(MIXED, fps)]
    if not rates:
        return False
    figure = Figure(figsize=(8, 0.9 + 2.4 * len(rates)), layout="constrained")
    for axes, fps in zip(figure.subplots(len(rates), squeeze=False)[:, 0], rates, strict=True):
        _bars(axes, results, fps)
    figure.savefig(file, dpi=RESOLUTION)
    return True


def _bars(axes: Axes, results: Results, fps: int) -> None:
    found = list(results.of(MIXED, fps).values())[::-1]
    middle = [one.rate for one in found]
    ends = [[one.rate - min(one.rates) for one in found], [max(one.rates) - one.rate for one in found]]
    colours = [COLOURS.get(one.engine, GREY) for one in found]
    drawn = axes.barh([one.engine for one in found], middle, xerr=ends, color=colours, capsize=3)
    axes.bar_label(drawn, [f"{rate:,.0f}" for rate in middle], padding=6)
    axes.set(xscale="log", xlabel="steps a second", title=f"Forty games mixed, {fps} fps, {_machine(results)}")
    axes.set_xlim(min(middle) / 3, max(middle) * 8)


def scaling(results: Results, file: Path) -> bool:
    """Draw speed against the batch, and each game's against its moving bodies; False if there is nothing to draw."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for threads in dict.fromkeys(one.threads for one in results.scales):
        line = [(one.batch, one.measured.rate) for one in results.scales if one.threads == threads]
        left.plot(*zip(*line, strict=True), marker="o", label=f"{threads} thread{'s' * (threads > 1)}")
    left.set(xscale="log", xlabel="worlds in a call", ylabel="steps a second", title="Forty games mixed, float32")
    points = 0
    for name, colour, shift in ((STEPPING, GREY, -0.1), (FLOAT64, LIGHT, 0.0), (FLOAT32, BLUE, 0.1)):
        games = [(one.work, one.rate) for one in results.measurements if one.engine == name and one.work != MIXED]
        moving = [iphyre_jax.load_scene(game).dynamic.sum() + shift for game, _ in games]
        right.scatter(moving, [rate for _, rate in games], s=14, color=colour, label=name)
        points += len(games)
    right.set(yscale="log", xlabel="moving bodies", ylabel="steps a second", title="Game by game")
    for axes in (left, right):
        if axes.has_data() and axes.get_legend_handles_labels()[0]:
            axes.legend()
    if not results.scales and not points:
        return False
    figure.savefig(file, dpi=RESOLUTION)
    return True


def _machine(results: Results) -> str:
    machine = results.around["machine"]
    return f"{machine['processor']}, {machine['cores']} cores"

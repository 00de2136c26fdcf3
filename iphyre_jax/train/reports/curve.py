"""The learning curve of a run as a picture."""

from __future__ import annotations

from pathlib import Path

from iphyre_jax.files import replacing
from iphyre_jax.paper import paper_numbers
from iphyre_jax.train.reports.report import training_name
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.logs import read

FILE = "curve.png"


def draw_curve(run: Path, config: TrainConfig) -> None:
    """Draw the metrics.csv of a run into its curve.png.

    Raises:
        ValueError, OSError: one line; metrics.csv holds something else, or the picture cannot be written.
    """
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    lines = read(run, ("episodes", "reward"), ("greedy_reward",))
    episodes = [int(line["episodes"]) for line in lines]
    greedy = [(int(line["episodes"]), float(line["greedy_reward"])) for line in lines if line["greedy_reward"]]
    figure = Figure(figsize=(7, 4.2), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(episodes, [float(line["reward"]) for line in lines], color="tab:blue", linewidth=1, label="sampled")
    if greedy:
        axes.plot(*zip(*greedy, strict=True), color="tab:orange", marker="o", markersize=3, label="greedy")
    reference = paper_numbers()["agents"]
    if not config.games and config.split in reference["Human"]:
        for name, rate, style in ((config.paper_name, 10, "--"), ("Human", 60, ":")):
            if name in reference:
                reward = reference[name][config.split][0]
                label = f"paper: {name} ({rate} fps), {reward:.1f}"
                axes.axhline(reward, color="grey", linestyle=style, linewidth=1, label=label)
    axes.set(xlabel="episodes", ylabel=f"mean reward, {training_name(config)}", title=config.agent_name)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    with replacing(run / FILE) as draft:
        figure.savefig(draft)

"""The learning curve of a run as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from iphyre_jax.train.config import TrainConfig
from iphyre_jax.train.report import agent_name, paper_numbers, training_name


def draw_curve(
    path: Path,
    config: TrainConfig,
    episodes: Sequence[int],
    sampled: Sequence[float],
    greedy: Sequence[tuple[int, float]],
) -> None:
    """Save the learning curve as PNG.

    Args:
        path: of the picture.
        config: of the run.
        episodes: episodes played up to each round.
        sampled: mean reward of each round's sampled plans.
        greedy: (episodes played, mean reward of greedy plans) wherever it was measured.
    """
    figure = Figure(figsize=(7, 4.2), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(episodes, sampled, color="tab:blue", linewidth=1, label="sampled plans")
    if greedy:
        axes.plot(*zip(*greedy, strict=True), color="tab:orange", marker="o", markersize=3, label="greedy plans")
    reference = paper_numbers()["agents"]
    if not config.games and config.split in reference["PPO-I"]:
        for name, rate, style in (("PPO-I", 10, "--"), ("Human", 60, ":")):
            reward = reference[name][config.split][0]
            label = f"paper: {name} ({rate} fps), {reward:.1f}"
            axes.axhline(reward, color="grey", linestyle=style, linewidth=1, label=label)
    axes.set(xlabel="episodes", ylabel=f"mean reward, {training_name(config)}", title=agent_name(config))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    figure.savefig(path)

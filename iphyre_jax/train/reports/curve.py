"""The learning curve of a run as a picture."""

from __future__ import annotations

from pathlib import Path
from textwrap import wrap

from iphyre_jax.files import replacing
from iphyre_jax.paper import paper_numbers
from iphyre_jax.train.reports.report import training_name
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.logs import read

FILE = "curve.png"


def draw_curve(run: Path, config: TrainConfig) -> None:
    """Draw the metrics.csv of a run into its curve.png.

    Sampled are all episodes of an update, greedy those of the training games, by the policy before it. The paper's
    lines are of whole splits, so they stand beside runs that play nothing else.

    Raises:
        ValueError, OSError: one line; metrics.csv holds something else, or the picture cannot be written.
    """
    from matplotlib.figure import Figure  # loads slowly, and every command imports this module

    lines = read(run, ("episodes", "reward"), ("greedy_reward",))
    episodes = [int(line["episodes"]) for line in lines]
    before = [count - config.episodes_per_update for count in episodes]
    measured = zip(before, (line["greedy_reward"] for line in lines), strict=True)
    greedy = [(count, float(reward)) for count, reward in measured if reward]
    figure = Figure(figsize=(7, 4.2), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(episodes, [float(line["reward"]) for line in lines], color="tab:blue", linewidth=1, label="sampled")
    if greedy:
        axes.plot(*zip(*greedy, strict=True), color="tab:orange", marker="o", markersize=3, label="greedy")
    reference = paper_numbers()["agents"]
    own = not (config.games or config.variations or config.scene_pool)  # else further scenes are among them
    if own and config.split in reference["Human"]:
        for name, rate, style in ((config.paper_name, 10, "--"), ("Human", 60, ":")):
            if name in reference:
                reward = reference[name][config.split][0]
                label = f"paper: {name} ({rate} fps), {reward:.1f}"
                axes.axhline(reward, color="grey", linestyle=style, linewidth=1, label=label)
    further = [*(["variations"] if config.variations else []), *(["generated scenes"] if config.scene_pool else [])]
    played = " and ".join([training_name(config), *further])
    axes.set(xlabel="episodes", ylabel="mean reward")
    axes.set_title("\n".join(wrap(config.agent_name, 88) + wrap(f"trained on {played}", 88)), fontsize="small")
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize="small")
    with replacing(run / FILE) as draft:
        figure.savefig(draft)

"""Tables of an evaluation beside the paper's numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from iphyre_jax.paper import paper_numbers
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.evaluate import OTHER, OWN, Evaluation
from iphyre_jax.train.settings.run import TrainConfig

COLUMNS: Final = (*PAPER_SPLITS, "all")
TITLES = {
    "basic": "Basic",
    "noisy": "Noisy",
    "compositional": "Compos.",
    "multi_ball": "Multi-ball",
    "unseen_basic": "Unseen basic",
    OWN: "Own scenes",
    OTHER: "Other scenes",
    "all": "All 40",
}


class Row(NamedTuple):
    """One line of the table by split."""

    name: str
    cells: tuple[str, ...]  # "reward success%" for each of COLUMNS, or "-"
    ours: bool


def training_name(config: TrainConfig) -> str:
    """The training games' name in results."""
    return ", ".join(Path(game).name for game in config.games) if config.games else f"{TITLES[config.split]} split"


def split_rows(evaluation: Evaluation) -> Iterator[Row]:
    """Two rows of this run, greedy and sampled, then the paper's humans, oracle and agents."""
    whole = {"all"} if set(PAPER_SPLITS) <= set(evaluation.splits) else set()
    for kind in ("greedy", "sampled"):
        cells = []
        for split in COLUMNS:
            if split in evaluation.splits or split in whole:
                score = evaluation.mean(kind, split)
                cells.append(_cell(score.reward, 100 * score.success))
            else:
                cells.append("-")
        yield Row(f"ours, {kind}", tuple(cells), True)
    for name, by_split in paper_numbers()["agents"].items():
        yield Row(f"paper: {name}", tuple(_cell(*by_split[split]) for split in COLUMNS), False)


def _cell(reward: float, success: float) -> str:
    """Reward and success rate."""
    return f"{reward:.1f} {success:3.0f}%"


def other_splits(evaluation: Evaluation) -> Iterator[str]:
    """Lines for the splits that the table has no column for: unseen basic games and scenes of one's own."""
    for split in evaluation.splits:
        for kind in ("greedy", "sampled") if split not in COLUMNS else ():
            score = evaluation.mean(kind, split)
            yield f"{TITLES[split]}, {kind}: {score.reward:.1f} ({100 * score.success:.0f} %)"


def seeds_cell(values: Sequence[float], factor: float = 1.0, digits: int = 1) -> str:
    """Mean ± standard deviation over seeds, of n - 1 degrees of freedom, as a cell; "-" if there are none."""
    if not values or not np.isfinite(values).all():
        return "-"
    mean = f"{factor * np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} ± {factor * np.std(values, ddof=1):.{digits}f}"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table: names to the left, numbers to the right."""
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def markdown(evaluation: Evaluation, config: TrainConfig, facts: Mapping[str, Any]) -> str:
    """The whole report as Markdown.

    Args:
        evaluation: of the policy.
        config: of the run.
        facts: further lines of the first table, name -> value (device, commit, versions, ...).
    """
    paper = paper_numbers()
    settings = {
        "agent": config.agent_name,
        "trained on": f"{training_name(config)}, {config.fps} physics steps a second, reset {config.resets}",
        "physics": config.dtype,
        "actions": f"greedy: one episode a game; sampled: {config.sampled_episodes} episodes a game",
        "unsound worlds": str(evaluation.faults),
        **{name: _fact(value) for name, value in facts.items()},
    }
    others = list(other_splits(evaluation))
    by_split = [[row.name, *row.cells] for row in split_rows(evaluation)]
    parts = [
        "# Evaluation",
        markdown_table(["", "value"], [[name, value] for name, value in settings.items()]),
        "## By split: reward and success",
        markdown_table(["", *(TITLES[split] for split in COLUMNS)], by_split),
        *(["\n".join(f"* {line}" for line in others)] if others else []),
        f"Paper: {paper['source']}. Protocol there: {paper['protocol']}. Ours: {config.fps} fps; rewards at different "
        "rates are not comparable.",
        "## By game",
        _game_table(evaluation),
    ]
    return "\n\n".join(parts) + "\n"


def _fact(value: object) -> str:
    """A fact in one cell."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {version}" for name, version in value.items())
    return "unknown" if value is None else str(value)


def _game_table(evaluation: Evaluation) -> str:
    """Each game with its greedy plan, its rewards and the paper's PPO-I and humans."""
    paper = paper_numbers()["per_game"]
    header = ["game", "split", "greedy", "solved", "sampled", "success %", "plan, s", "paper PPO-I", "paper Human"]
    rows = []
    for score in evaluation.games:
        there = paper.get(score.game, {}) if score.scene is None else {}
        rows.append(
            [
                score.game,
                TITLES[score.split],
                f"{score.greedy.reward:.1f}",
                "yes" if score.greedy.success else "no",
                f"{score.sampled.reward:.1f}",
                f"{100 * score.sampled.success:.0f}",
                " ".join("-" if time is None else f"{time:.1f}" for time in score.plan),
                *(f"{there[name]:.1f}" if name in there else "-" for name in ("PPO-I", "Human")),
            ]
        )
    return markdown_table(header, rows)

"""Every row of docs/results/outcome.md, one after the other; goes on where it stopped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from iphyre_jax.checks import check_option
from iphyre_jax.data.dataset import Dataset
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.outcome import baselines, report, runs, storage
from iphyre_jax.models.outcome.agent import Agent, draw_randomly, ranking_agent, solved_within
from iphyre_jax.models.outcome.plays.audit import outcome_dependence
from iphyre_jax.models.outcome.plays.sets import (
    PlaySets,
    judged_plays,
    learned_plays,
    natural_rates,
    play_sets,
)
from iphyre_jax.models.outcome.settings import OutcomeConfig, settings
from iphyre_jax.models.outcome.training import OutcomeState
from iphyre_jax.models.storage import EVALUATION
from iphyre_jax.provenance import provenance_facts
from iphyre_jax.scenes import GAMES, SPLITS

ROWS: Final = {
    config.name: config
    for config in (
        *(settings("paper", name) for name in ("global", "object", "vision", "plan", "scene")),
        *(settings("clean", name) for name in ("global", "object", "vision", "plan", "scene")),
        settings("relations"),
    )
}
AGENTS: Final = ("paper-global", "paper-object", "clean-plan", "relations")  # rows that ship, and play
ATTEMPTS: Final = 10
REPEATS: Final = 10  # of each game, with other random plans
SPLITS_PLAYED: Final = ("basic", "noisy", "compositional", "multi_ball")
BASELINES: Final = "baselines.json"


@dataclass(frozen=True)
class Comparison:
    """Where a comparison reads and writes.

    Attributes:
        root: folder of the run folders and of the data sets.
        out: the document.
        weights: folder for the best network of each row of AGENTS; None to ship nothing.
    """

    root: Path = Path("build/outcome")
    out: Path = Path("docs/results/outcome.md")
    weights: Path | None = None


def make_row(
    where: Comparison, config: OutcomeConfig, sets: PlaySets, console: Console
) -> tuple[OutcomeState | None, dict[str, Any]]:
    """Train and evaluate a row, or what is left of it.

    Returns:
        The state, None if the row was done before, and its evaluation.
    """
    folder = where.root / config.name
    if (folder / EVALUATION).is_file():
        found = storage.RUNS.read_evaluation(folder)
        if found.get("settings") == config.to_json():
            return None, found
    learned, varied = learned_plays(sets, config.data, where.root / "data", console)
    state = runs.train(folder, config, learned, sets.choose, console)
    judged = judged_plays(sets, learned, varied)
    evaluation = runs.evaluate(folder, config, state, judged, natural_rates(sets.official))
    storage.save_classifier(runs.shipped(config, state, evaluation), folder / "best")
    return state, evaluation


def baseline_rows(sets: PlaySets) -> dict[str, dict[str, Any]]:
    """Rows that need no network."""
    learned = learned_plays(sets, "official", Path(), Console(quiet=True))[0]
    judged = judged_plays(sets, learned, learned.select(np.zeros(len(learned), bool)))
    rates = natural_rates(sets.official)

    def row(judge: Any) -> dict[str, Any]:  # noqa: ANN401 - a function from plays to chances
        return {
            "columns": {
                name: runs.measured(plays, judge(plays)[None], rates if len(plays.scenes) == len(rates) else None)
                for name, plays in judged.items()
                if len(plays)
            }
        }

    return {
        "always fail": row(baselines.always_fail),
        "count, one threshold": row(lambda plays: baselines.count_rule(learned, plays)),
        "count, fitted to each judged game": row(baselines.count_bound),
    }


def play_agent(where: Comparison, name: str, agent: Agent, console: Console) -> Row:
    """Shares solved within 1, ..., k attempts by split, and by game in "games"; kept in a file beside the runs."""

    def play() -> Row:
        with console.status(f"{name} plays {len(GAMES)} games"):
            shares = solved_within(agent, GAMES, ATTEMPTS, REPEATS)
        by_game = dict(zip(GAMES, shares, strict=True))
        by_split = {split: np.mean([by_game[game] for game in SPLITS[split]], axis=0) for split in SPLITS_PLAYED}
        found = {split: share.tolist() for split, share in by_split.items()}
        return {**found, "games": {game: share.tolist() for game, share in by_game.items()}}

    return kept_row(where.root / "agents", name, {"attempts": ATTEMPTS, "repeats": REPEATS}, play)


def compare(where: Comparison, console: Console, only: Sequence[str] = ()) -> None:
    """Train what is missing, row by row, and write the document after each.

    Args:
        where: folders.
        console: for progress.
        only: names of rows; by default all.

    Raises:
        ValueError: one line; there is no such row, or a folder holds another run.
    """
    wanted = [check_option("only", name, tuple(ROWS)) for name in only] or list(ROWS)
    sets = play_sets(where.root / "data", console)
    found: dict[str, dict[str, Any]] = baseline_rows(sets)
    facts = {"dependence of the inputs on the outcome": _dependence(sets.official), **provenance_facts()}
    agents: dict[str, Row] = {"random plans": play_agent(where, "random", draw_randomly, console)}
    for name, config in ROWS.items():
        if name in wanted:
            found[name] = make_row(where, config, sets, console)[1]
        elif (where.root / name / EVALUATION).is_file():
            found[name] = storage.RUNS.read_evaluation(where.root / name)
        if name in found and name in AGENTS:
            best = storage.load_classifier(name, where.root / name / "best")
            if where.weights is not None:
                storage.save_classifier(best, where.weights)
            agents[name] = play_agent(where, name, ranking_agent(best), console)
        report.write(where.out, found, agents, [row for row in ROWS if row not in found], facts)
    console.print(f"Written: {where.out}")


def _dependence(plays: Dataset) -> str:
    """What the audit says of the inputs of two presets."""
    shares = {name: outcome_dependence(plays, settings(name)) for name in ("paper", "clean")}
    return ", ".join(f"{name} {100 * share:.1f} % of the plans" for name, share in shares.items())

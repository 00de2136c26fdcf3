"""Every row of docs/results/outcome.md, one after the other; goes on where it stopped."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console

from iphyre_jax.attempts.agents import draw_randomly
from iphyre_jax.attempts.protocol import Agent
from iphyre_jax.data.dataset import Dataset
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.models.outcome import baselines, report, runs, storage
from iphyre_jax.models.outcome.agent import ranking_agent, solved_within
from iphyre_jax.models.outcome.plays.audit import outcome_dependence
from iphyre_jax.models.outcome.plays.sets import (
    PlaySets,
    held_out_plays,
    judged_plays,
    learned_plays,
    natural_rates,
    play_sets,
)
from iphyre_jax.models.outcome.settings import OutcomeConfig, settings
from iphyre_jax.models.settings import wanted_rows
from iphyre_jax.models.storage import Comparison
from iphyre_jax.provenance import provenance_facts
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.scenes.library import PAPER_SPLITS
from iphyre_jax.train.reports.printing import say

ROWS: Final = {
    config.name: config
    for config in (
        *(settings("paper", name) for name in ("global", "object", "vision", "plan", "scene")),
        *(settings("clean", name) for name in ("global", "object", "vision", "plan", "scene")),
        dataclasses.replace(settings("relations"), data="large"),
        settings("relations"),
    )
}
AGENTS: Final = ("paper-global", "paper-object", "clean-plan", "relations-basic", "relations")  # these ship
NETWORKS: Final = "networks"  # folder of the networks of all seeds, in a run folder
ATTEMPTS: Final = 10
REPEATS: Final = 10  # of each game, with other random plans


def make_row(root: Path, config: OutcomeConfig, sets: PlaySets, console: Console) -> dict[str, Any]:
    """Train and evaluate a row in its run folder, or what is left of that; its evaluation."""
    folder = root / config.name
    learned = learned_plays(sets, config.data, root / "data", console)
    state = runs.train(folder, config, learned, sets.choose, console)
    judged = judged_plays(sets, learned, held_out_plays(config.data, root / "data", console))
    evaluation = runs.evaluate(folder, config, state, judged, natural_rates(sets.official))
    for seed in range(config.seeds):
        network = runs.trained(config, state, evaluation, seed)
        storage.FILES.save(folder / NETWORKS, dataclasses.replace(network, name=str(seed)))
    return evaluation


def published_row(where: Comparison, config: OutcomeConfig, sets: PlaySets, console: Console) -> dict[str, Any]:
    """The evaluation of a row that is published; if there is none yet, `make_row` and publish it."""
    return storage.RUNS.published_row(where, config, lambda: make_row(where.root, config, sets, console))


def baseline_rows(sets: PlaySets) -> dict[str, dict[str, Any]]:
    """Rows that need no network."""
    learned = learned_plays(sets, "official", Path(), Console(quiet=True))
    judged = judged_plays(sets, learned, {})
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


def play_agent(where: Comparison, name: str, of: Mapping[str, Any], agent: Callable[[], Agent]) -> Row:
    """Shares solved within 1, ..., k attempts by split, and by game in "games"; kept in a file beside the runs.

    Args:
        where: folders.
        name: of the row.
        of: what decides the agent, JSON values.
        agent: gives the agent, if it has to play.
    """

    def play() -> Row:
        shares = solved_within(agent(), GAMES, ATTEMPTS, REPEATS)
        by_game = dict(zip(GAMES, shares, strict=True))
        by_split = {split: np.mean([by_game[game] for game in SPLITS[split]], axis=0) for split in PAPER_SPLITS}
        found = {split: share.tolist() for split, share in by_split.items()}
        return {**found, "games": {game: share.tolist() for game, share in by_game.items()}}

    return kept_row(where.published / "agents", name, {"attempts": ATTEMPTS, "repeats": REPEATS, **of}, play)


def compare(where: Comparison, console: Console, only: Sequence[str] = ()) -> None:
    """Train what is missing, row by row, and write the document after each.

    Args:
        where: folders.
        console: for progress.
        only: names of rows; by default all.

    Raises:
        ValueError: one line; there is no such row, or a folder holds another run.
    """
    wanted = wanted_rows(ROWS, only)
    sets = play_sets(where.root / "data", console)
    found: dict[str, dict[str, Any]] = baseline_rows(sets)
    facts = {"dependence of the inputs on the outcome": _dependence(sets.official), **provenance_facts()}
    agents: dict[str, list[Row]] = {"random plans": [play_agent(where, "random", {}, lambda: draw_randomly)]}
    for name, config in ROWS.items():
        if name in wanted:
            found[name] = published_row(where, config, sets, console)
        elif (known := storage.RUNS.read_published(where.published / name, config)) is not None:
            found[name] = known
        folder = where.root / name / NETWORKS
        if name in found and name in AGENTS and where.weights is not None and folder.is_dir():
            best = storage.load_classifier(str(runs.best_seed(found[name])), folder)
            storage.FILES.save(where.weights, runs.shipped(best))
        if name in found and name in AGENTS:
            with console.status(f"{name} plays {len(GAMES)} games"):
                agents[name] = [
                    play_agent(where, f"{name}-{seed}", {"settings": config.to_json()}, partial(_ranking, folder, seed))
                    for seed in range(config.seeds)
                ]
        report.write(where.out, found, agents, [row for row in ROWS if row not in found], facts)
    say(console, f"Written: {where.out}")


def _ranking(networks: Path, seed: int) -> Agent:
    return ranking_agent(storage.load_classifier(str(seed), networks))


def _dependence(plays: Dataset) -> str:
    """What the audit says of the inputs of two presets."""
    shares = {name: outcome_dependence(plays, settings(name)) for name in ("paper", "clean")}
    return ", ".join(f"{name} {100 * share:.1f} % of the plans" for name, share in shares.items())

"""`make on-the-fly`: the shipped policies that act on the fly, greedily in two ways, beside their sampled actions.

    python -m benchmarks.learning.on_the_fly --out docs/results
    python -m benchmarks.learning.on_the_fly --out docs/results --test    # plays the forty games too, and counts it

The mode takes the most likely action at each decision; the median waits until half of the policy's chance of acting has
passed (`train/hazard.py`). The rule was chosen on the basic games and their unseen layouts. The table of all forty
games has the scores that ship with the weights; with --test these are written anew.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import jax
import numpy as np

from benchmarks.learning.agents import SEEDS, is_published
from benchmarks.learning.rows import rows as table_rows
from iphyre_jax.execution.configuration import configure
from iphyre_jax.files import read_json_object, replace_json, replace_text
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import SPLITS, Scene
from iphyre_jax.scenes.library import ALL_GAMES
from iphyre_jax.train.algos.base import preferring
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.collect import PolicyFn, rollout_collector
from iphyre_jax.train.reports import compare
from iphyre_jax.train.reports.report import COLUMNS, TITLES, markdown_table
from iphyre_jax.train.reports.statistics import Summary
from iphyre_jax.train.scenes import variations
from iphyre_jax.train.storage import runs
from iphyre_jax.train.storage.pretrained import WEIGHTS, Pretrained, load_pretrained, save_pretrained
from parity.command import run

POLICIES: Final = ("ppo-o", "a2c-o", "sac-o", "dqn-o")
SAMPLES: Final = 20  # episodes of a scene with sampled actions
VARIED: Final = 5  # variations of each basic game; these policies were trained on none
VARIED_SEED: Final = 20
COUNTER: Final = "forty-on-the-fly.json"  # how often this command has played the forty games


@dataclass(frozen=True)
class Arguments:
    """Play the shipped policies that act on the fly."""

    out: Path = Path("docs/results")
    """Folder of on-the-fly.md and of the count of runs."""
    runs: Path = Path("docs/results/runs")
    """Folder of what `make results` published. A policy whose seeds are all there gets a row of their means."""
    test: bool = False
    """Play the forty games too, count it, and write the scores of the shipped weights anew."""


def main(arguments: Arguments) -> None:
    """Play and write the document."""
    configure()
    policies = [load_pretrained(name) for name in POLICIES]
    varied = [scene for game in SPLITS["basic"] for scene in variations(game, VARIED, VARIED_SEED)]
    games: dict[str, Sequence[str | Scene]] = {
        "Basic": SPLITS["basic"],
        "Unseen basic": SPLITS["unseen_basic"],
        f"{len(varied)} variations": varied,
    }
    means = {policy.name: [_means(policy, scenes) for scenes in games.values()] for policy in policies}
    parts = [
        _intro(policies[0]),
        _table(list(games), means),
        _seeds(arguments.runs),
        *_elsewhere(policies, arguments.runs),
    ]
    counter = arguments.out / COUNTER
    if arguments.test:
        counted(counter)
        policies = [_evaluated(policy) for policy in policies]
    parts.append(forty(policies, runs_in(counter)))
    parts.append(f"## Origin\n\n```json\n{json.dumps(provenance(), indent=1)}\n```")
    arguments.out.mkdir(parents=True, exist_ok=True)
    replace_text(arguments.out / "on-the-fly.md", "\n\n".join(parts) + "\n")


def _means(policy: Pretrained, scenes: Sequence[str | Scene]) -> tuple[float, float, float]:
    """Mean rewards of the mode, of the median and of sampled actions."""
    agent = algorithm(policy.config)

    sampled = partial(agent.sample_action, policy.state)
    rollout = rollout_collector(policy.config, scenes)

    def mean(chosen: PolicyFn, episodes: int) -> float:
        return float(np.mean(rollout.collect(chosen, jax.random.key(0), episodes)[1].reward))

    mode, median = preferring(policy.greedy), preferring(agent.greedy_policy(policy.state))
    return mean(mode, 1), mean(median, 1), mean(sampled, SAMPLES)


def _intro(policy: Pretrained) -> str:
    """What was played, and how."""
    config = policy.config
    return (
        "# On the fly, greedily\n\nWritten by `make on-the-fly`. Shipped policies, one seed each: the best of five by "
        f"median on basic and unseen basic games. {config.fps} fps, reset {config.resets}, {config.dtype}. Mode: the "
        "most likely action at each decision. Median: the next block goes when half of the policy's chance of acting "
        "has passed; a block that has gone is not chosen again. Both play one episode a scene, sampled actions "
        f"{SAMPLES}, drawn anew, so that means differ a little from those that ship. The median was chosen on basic "
        "and unseen basic games; variations are of the basic games, and none was trained on."
    )


def _table(titles: Sequence[str], means: dict[str, list[tuple[float, float, float]]]) -> str:
    """Mode, median and sampled of each policy, for each kind of scene."""
    header = ["policy", *(f"{title}: {kind}" for title in titles for kind in ("mode", "median", "sampled"))]
    rows = [[name, *(f"{value:.1f}" for kinds in found for value in kinds)] for name, found in means.items()]
    return markdown_table(header, rows)


def _seeds(root: Path) -> str:
    """Greedy (median) and sampled rewards of all seeds, as `make results` trained and evaluated them."""
    rows, table = [], table_rows()
    for name in POLICIES:
        wanted = {root / name / f"seed-{seed}": replace(table[name], seed=seed) for seed in range(SEEDS)}
        if not all(is_published(*run) for run in wanted.items()):
            continue
        (row,) = compare.rows([compare.read(folder) for folder in wanted])
        greedy, sampled = (_summary(row, kind, "basic") for kind in ("greedy", "sampled"))
        both = [f"{of.mean:.1f} {of.estimate.bounds()}" for of in (greedy, sampled)]
        unseen = [f"{_summary(row, kind, 'unseen_basic').mean:.1f}" for kind in ("greedy", "sampled")]
        rows.append([name, *both, f"{greedy.mean - sampled.mean:+.1f}", *unseen])
    header = [
        "policy",
        "Basic: greedy",
        "Basic: sampled",
        "difference",
        "Unseen basic: greedy",
        "Unseen basic: sampled",
    ]
    text = (
        f"Means of {SEEDS} seeds with 95 % t intervals over seeds; greedy is the median. Policies whose seeds "
        "are not all trained with the settings of today are left out: `make results` trains them."
    )
    return f"## All seeds\n\n{text}\n\n{markdown_table(header, rows)}"


def _elsewhere(policies: Sequence[Pretrained], root: Path) -> list[str]:
    """A sentence about policies that come from another training than the published seeds, if there are any."""
    commits = {}
    for policy in policies:
        trained = policy.origin["trained"]
        files = (root / policy.name).glob(f"seed-*/{runs.CONFIG}")
        if all(read_json_object(file)["started"] != trained["started"] for file in files):
            commits[policy.name] = trained["commit"][:8]
    listed = ", ".join(f"{name} (commit {commit})" for name, commit in commits.items())
    return [f"Shipped from an earlier training, not from these seeds: {listed}."] if listed else []


def _summary(row: compare.Row, kind: str, split: str) -> Summary:
    """Of all seeds; `make results` plays every split."""
    return cast(Summary, row.summary(kind, split))


def runs_in(file: Path) -> int:
    """How many runs on the forty games a file has counted."""
    return int(read_json_object(file)["runs"]) if file.is_file() else 0


def counted(file: Path) -> None:
    """Count a run on the forty games before it begins."""
    file.parent.mkdir(parents=True, exist_ok=True)
    replace_json(file, {"runs": runs_in(file) + 1})


def _evaluated(policy: Pretrained) -> Pretrained:
    """Play all games and write the scores of the shipped weights anew."""
    scores: dict[str, Any] = policy.evaluate(ALL_GAMES).to_json()
    origin = {key: value for key, value in policy.origin.items() if key != "evaluated"}
    save_pretrained(policy.name, policy.config, policy.state, scores, origin, WEIGHTS)
    return load_pretrained(policy.name)


def forty(policies: Sequence[Pretrained], played: int) -> str:
    """Greedy (median) and sampled rewards by split, as the shipped weights have them."""
    rows = []
    for policy in policies:
        splits = policy.scores["splits"]
        for kind in ("greedy", "sampled"):
            found = [splits[split][kind] for split in COLUMNS]
            cells = [f"{score['reward']:.1f} {100 * score['success']:.0f}%" for score in found]
            rows.append([f"{policy.name}, {kind}", *cells])
    header = ["policy", *(TITLES[split] for split in COLUMNS)]
    text = f"The scores of the shipped weights. Times that this command has played these games: {played}."
    return f"## All forty games\n\n{text}\n\n{markdown_table(header, rows)}"


if __name__ == "__main__":
    sys.exit(run(main, Arguments))

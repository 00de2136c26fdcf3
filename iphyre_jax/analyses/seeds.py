"""Scores of all seeds of the agents of which one seed ships, as `make results` publishes them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from iphyre_jax.scenes import SPLITS
from iphyre_jax.train.reports.compare import KINDS, Row, read, rows
from iphyre_jax.train.reports.statistics import Summary, summary
from iphyre_jax.train.storage.pretrained import names

GREEDY, SAMPLED = KINDS
_NEEDED: Final = ("basic", "unseen_basic")


def published(folder: Path) -> dict[str, Row]:
    """Return each agent's seeds, by its name in the package.

    Args:
        folder: of the runs: NAME/seed-N/.

    Raises:
        ValueError, OSError: one line; seeds are missing, or a file is damaged.
    """
    found = {}
    for name in names():
        runs = sorted((folder / name).glob("seed-*"))
        if not runs:
            raise ValueError(f"runs: expected {folder / name}/seed-*, which `make results` publishes; there are none")
        evaluated = [read(run) for run in runs]
        for run in evaluated:
            for split in _NEEDED:
                if not set(SPLITS[split]) <= set(run.games):
                    raise ValueError(f"{run.path}: expected scores of the games of {split}, they are not there")
        row, *others = rows(evaluated)
        if others:
            raise ValueError(f"runs: expected seeds of one agent in {folder / name}, their settings differ")
        found[name] = row
    return found


def unseen_difference(row: Row) -> Summary:
    """Return the greedy reward of unseen basic games less that of basic ones, over the seeds."""
    basic, unseen = ([seed.scores(GREEDY, split) for seed in row.seeds] for split in _NEEDED)
    return summary(np.subtract(unseen, basic).tolist())

"""Audits: does what a classifier sees tell of the outcome by other ways than the scene and the plan?"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.metrics import auroc
from iphyre_jax.models.outcome.plays.inputs import Examples, scene_inputs
from iphyre_jax.models.outcome.plays.inputs import examples as official_examples
from iphyre_jax.models.outcome.settings import OutcomeConfig

SUSPICIOUS: Final = 0.99  # of plans that one number alone ranks rightly within nearly every game

Build = Callable[[Dataset, OutcomeConfig], Examples]


def columns(examples: Examples, rows: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float64]]:
    """Every single number that a network sees, by name, (N,) each."""
    parts = {
        "seconds": np.asarray(examples.plans.seconds),
        "removed": np.asarray(examples.plans.removed),
        "rows": rows[np.asarray(examples.game)].reshape(len(examples.label), -1),
    }
    return {f"{name} {k}": np.asarray(part[:, k], float) for name, part in parts.items() for k in range(part.shape[1])}


def telling_columns(examples: Examples, rows: npt.NDArray[np.float32]) -> dict[str, float]:
    """The numbers that alone rank the plans of nearly every game by their outcome, with how well: leaks.

    No honest number of scene or plan does that: the scene is the same for all plans of a game, and a removal counts for
    other things in each.

    Args:
        examples: what is learned from.
        rows: (S, 12, 9) tables of its scenes.
    """
    game, label = np.asarray(examples.game), np.asarray(examples.label) > 0
    found = {}
    for name, values in columns(examples, rows).items():
        each = np.array([auroc(label[game == one], values[game == one]) for one in np.unique(game)])
        power = np.abs(each[~np.isnan(each)] - 0.5) + 0.5
        if len(power) and power.mean() >= SUSPICIOUS:
            found[name] = float(power.mean())
    return found


def outcome_dependence(dataset: Dataset, config: OutcomeConfig, build: Build = official_examples) -> float:
    """The share of plans whose inputs change if only the outcomes of the plays do; 0 for honest inputs.

    Args:
        dataset: plays.
        config: settings; `masked_times` depends on when a play ended, as the official files do.
        build: from data set and settings to examples.
    """
    order = np.random.default_rng(0).permutation(len(dataset.game))
    outcomes = ("success", "end_step", "removals")
    other = dataclasses.replace(dataset, **{name: getattr(dataset, name)[order] for name in outcomes})
    rows = np.asarray(scene_inputs(dataset.scenes, dataclasses.replace(config, network="global")).rows)
    one, two = (columns(build(each, config), rows) for each in (dataset, other))
    changed = np.any([one[name] != two[name] for name in one], axis=0)
    return float(changed.mean())

"""Plays that a ranker learns most from: fresh scenes, and the proposed plans that it believes in (hard negatives).

Of random plans to do nothing is always among them, for some scenes solve themselves; of a policy's, the greedy one.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.augmented import play
from iphyre_jax.models.outcome.plays.inputs import Plans, plan_inputs, scene_inputs
from iphyre_jax.models.outcome.plays.pool import by_topology, kept_in_parts, protocol_of
from iphyre_jax.models.outcome.plays.proposals import Propose, random_proposals
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.training import Params, predict_groups
from iphyre_jax.scenes import Scene

DRAWN: Final = 160  # plans of a scene that are judged; of these are played ...
BEST: Final = 16  # ... the first, and those that it believes in most,
OTHERS: Final = 8  # ... and some of the others
STREAM: Final = 99  # of random numbers


def collect_hard(
    scenes: Sequence[Scene],
    config: OutcomeConfig,
    params: Params,
    number: int,
    first: int = 0,
    propose: Propose = random_proposals,
) -> Dataset:
    """Play of each scene the first plan that is proposed, those that one ranker believes in, and some others.

    Args:
        scenes: which it has not learned from; on others its mistakes are few.
        config: settings of the ranker.
        params: of the ranker, with an axis of one seed in front.
        number: of the refinement, 0, 1, ...; each draws other plans.
        first: index of the first scene, likewise.
        propose: gives the plans.
    """
    rng = np.random.default_rng([STREAM, first, number])
    times = propose(scenes, DRAWN, rng)
    which = np.repeat(np.arange(len(scenes), dtype=np.int32), DRAWN)
    flat = plan_inputs(scenes, which, times.reshape(len(which), -1), config)
    plans = Plans(*(np.asarray(part).reshape(len(scenes), DRAWN, -1) for part in flat))
    chance = predict_groups(config, params, scene_inputs(scenes, config), plans)[0].copy()
    chance[:, 0] = np.inf
    order = np.argsort(-chance, axis=1)
    others = np.stack([rng.choice(row[BEST:], OTHERS, replace=False) for row in order])
    played = np.concatenate([order[:, :BEST], others], axis=1)
    times = np.take_along_axis(times, played[..., None], axis=1).reshape(played.size, -1)
    which = np.repeat(np.arange(len(scenes), dtype=np.int32), BEST + OTHERS)
    return play(scenes, which, times, np.arange(len(which), dtype=np.int32), protocol_of(config))


def hard_plays(
    fresh: Sequence[Scene],
    config: OutcomeConfig,
    params: Params,
    number: int,
    folder: Path,
    console: Console,
    propose: Propose = random_proposals,
) -> Dataset:
    """`collect_hard` of all scenes; what is missing in the folder that keeps the plays is played."""

    def collect(scenes: Sequence[Scene], first: int) -> Dataset:
        return collect_hard(scenes, config, params, number, first, propose)

    return kept_in_parts(by_topology(fresh), "what the ranker believes in", collect, folder, console)

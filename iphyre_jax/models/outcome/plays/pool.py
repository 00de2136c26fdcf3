"""Plays for the ranker: scenes of a generated file, the basic games and variations of them, at an agent's rate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.console import Console

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.labels import PlayProtocol
from iphyre_jax.models.outcome.plays.augmented import collect_scenes, joined, kept_plays, scenes_of
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.rules import DECISIONS_PER_SECOND, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE, SPLITS, Scene, load_scene
from iphyre_jax.scenes.compile import topology_of

VARIED: Final = 200  # variations of each basic game
PLANS: Final = 64  # random ones of each scene ...
NEAR: Final = 48  # ... and, on average, neighbours of those that solve it
PART: Final = 1000  # scenes whose plays are kept in a file
LAST: Final = TIME_LIMIT - 1 / DECISIONS_PER_SECOND  # s, the last instant of a plan
EARLY, LATE = 1.5, 4.0  # s, mean times of hasty and of slow plans
UNIFORM: Final = 12.0  # s, below which some times are drawn evenly
START, APART = 3.0, 0.5  # s, means of the first time of a burst, and of how much later each block of it goes

Floats = npt.NDArray[np.float64]


def wide_plans(blocks: int, count: int, rng: np.random.Generator) -> Floats:
    """Plans as varied as those of policies, (count, 6) s; NaN for a block that stays or is not there.

    The official distribution ends at 6.9 s and spreads times evenly. Policies wait longer, and remove blocks at once or
    shortly after one another.
    """
    shape = (count, MAX_ELIMINABLE)
    seconds = rng.exponential(rng.choice([EARLY, LATE], (count, 1)), shape)
    seconds = np.where(rng.random(shape) < 0.3, rng.uniform(0, UNIFORM, shape), seconds)
    burst = rng.exponential(START, (count, 1)) + rng.exponential(APART, shape)
    seconds = np.where((rng.random((count, 1)) < 0.4) & (rng.random(shape) < 0.7), burst, seconds)
    instants = np.ceil(np.minimum(seconds, LAST) * DECISIONS_PER_SECOND) / DECISIONS_PER_SECOND
    stays = rng.random(shape) < rng.uniform(0.1, 0.6, (count, 1))
    return np.where(stays | (np.arange(MAX_ELIMINABLE) >= blocks), np.nan, instants)


def pool_scenes(generated: Sequence[Scene]) -> list[Scene]:
    """Generated scenes, basic games and variations, those of a topology together: so they are played in fewer calls."""
    varied = [scene for game in SPLITS["basic"] for scene in (load_scene(game), *scenes_of(game, VARIED, 0))]
    return by_topology([*generated, *varied])


def by_topology(scenes: Sequence[Scene]) -> list[Scene]:
    """Scenes, those of a topology together, else in order."""
    topologies = [topology_of(scene) for scene in scenes]
    number = {topology: k for k, topology in enumerate(dict.fromkeys(topologies))}
    order = sorted(range(len(scenes)), key=lambda k: number[topologies[k]])
    return [scenes[k] for k in order]


def pool_plays(generated: Sequence[Scene], config: OutcomeConfig, folder: Path, console: Console) -> Dataset:
    """Plays of `pool_scenes`; what is missing in the folder that keeps them is played.

    Args:
        generated: scenes; the folder is theirs alone.
        config: rate and reset.
        folder: of the plays.
        console: for progress.
    """

    def collect(scenes: Sequence[Scene], first: int) -> Dataset:
        return collect_scenes(scenes, PLANS, NEAR, first, protocol_of(config), wide_plans)

    return kept_in_parts(pool_scenes(generated), f"random plans at {config.fps} fps", collect, folder, console)


def protocol_of(config: OutcomeConfig) -> PlayProtocol:
    """How the plays are made: ties and times are read as in the agents' environment (the rule "in_advance")."""
    return PlayProtocol(config.fps, "in_advance", config.resets)


def kept_in_parts(
    scenes: Sequence[Scene],
    what: str,
    collect: Callable[[Sequence[Scene], int], Dataset],
    folder: Path,
    console: Console,
) -> Dataset:
    """Plays of scenes from the folder that keeps them, PART scenes in a file; what is missing is played.

    Args:
        scenes: all of them, in the order in which they are cut.
        what: is played, for the title.
        collect: plays some scenes, of which the first has this index.
        folder: of the plays.
        console: for progress.
    """
    parts = []
    for first in range(0, len(scenes), PART):
        some = scenes[first : first + PART]
        title = f"playing {what}: scenes {first} to {first + len(some)} of {len(scenes)}"
        parts.append(kept_plays(folder, f"part-{first // PART:03d}", title, partial(collect, some, first), console))
    return joined(parts)

"""Data sets of variations: many seeded variations of each game, the same number of random plans for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain, islice
from typing import Any, Final

import numpy as np

from iphyre_jax.data.collection import build
from iphyre_jax.data.dataset import Dataset, scene_entry
from iphyre_jax.data.draws import random_plans
from iphyre_jax.data.journal import Journal
from iphyre_jax.data.labels import label_plans
from iphyre_jax.data.recipe import Recipe, check_poses
from iphyre_jax.scenes import Scene, vary

SHIFT, SCALE, JITTER = 60.0, 1.05, 8.0  # px, factor, px: the most that a variation differs by, as in training
DRAWN: Final = 1_000  # variations at a time; of angle one in 100 is valid
TRIES: Final = 500  # times that so many are drawn
EDGES: Final = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7)  # shares of random plans that solve: where a level begins or ends


def valid_variations(scene: Scene, count: int, seed: int) -> tuple[Scene, ...]:
    """Return so many valid variations of a scene, fewer if they are very rare."""
    return tuple(islice(chain.from_iterable(_draw(scene, seed)), count))


def _draw(scene: Scene, seed: int) -> Iterator[tuple[Scene, ...]]:
    for number in range(TRIES):
        yield vary(scene, DRAWN, seed=seed * TRIES + number, shift_px=SHIFT, scale_by=SCALE, jitter_px=JITTER).scenes


def level_of(solved: int, plans: int) -> int:
    """Return the level of a scene, 0 the hardest: in which interval of EDGES the share of solving plans lies."""
    return int(np.searchsorted(EDGES, solved / plans, side="right")) if plans else 0


def varied_plays(games: Sequence[Scene], count: int, plans: int, recipe: Recipe, journal: Journal) -> Dataset:
    """Play random plans of variations; all plays are kept, at their natural rate of success.

    Args:
        games: the originals.
        count: variations of each.
        plans: of each variation; no two variations see the same stream of plans.
        recipe: its protocol, seed, sequences and split are used. Other seeds give other variations.
        journal: keeps what is done.

    Returns:
        The plays; the manifest has for each variation its `game`, how many plans solve it, and its `level`.
    """
    check_poses(recipe, games, len(games) * count * plans)
    groups = [valid_variations(game, count, recipe.seed) for game in games]
    scenes = [scene for group in groups for scene in group]
    journal.report(f"{len(scenes)} variations")
    first = recipe.seed * len(games) * count
    times = np.array([plan for k, scene in enumerate(scenes) for plan in _plans(scene, first + k, plans)])
    game = np.repeat(np.arange(len(scenes)), plans)
    labels = label_plans(scenes, game, recipe.protocol.steps(times), recipe.protocol, None, journal)
    solved = np.bincount(game, labels.success, len(scenes)).astype(int).tolist()
    originals = [game.name for game, group in zip(games, groups, strict=True) for _ in group]
    entries: list[dict[str, Any]] = [
        {**scene_entry(scene), "game": of, "draws": plans, "solved": share, "level": level_of(share, plans)}
        for scene, of, share in zip(scenes, originals, solved, strict=True)
    ]
    sound = labels.fault == 0
    columns = labels.take(sound).columns(np.tile(np.arange(plans), len(scenes))[sound])
    return build(scenes, game[sound], times[sound], columns, recipe, journal, {"edges": list(EDGES), "scenes": entries})


def _plans(scene: Scene, seed: int, count: int) -> list[list[float]]:
    return [list(plan) for plan in islice(random_plans(scene, "official", seed), count)]

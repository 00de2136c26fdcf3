"""The scenes of a round: the training games, or variations of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Final

import numpy as np

from iphyre_jax.scenes import MAX_OBJECTS, Scene, load_scene, vary
from iphyre_jax.train.config import TrainConfig

GROUP: Final = 32  # episodes of one variation that are compared with one another
SHIFT, SCALE, JITTER = 60.0, 1.05, 8.0  # px, factor, px: the most that a variation differs by
STRENGTHS: Final = (1.0, 0.5, 0.25)  # of these limits, each tried if all variations within the one before are refused
STREAM: Final = 7919  # added to the seed: variations draw other numbers than anything else


def training_scenes(config: TrainConfig, update: int) -> tuple[Sequence[str | Scene], int]:
    """The scenes of a round, game by game, and the number of episodes of each.

    Without variations these are the games. With them, each game's episodes are shared by the game itself and so many of
    its variations, drawn by seed and round, that each has about GROUP episodes.
    """
    if not config.variations:
        return config.training_games, config.episodes_per_scene
    groups = max(1, config.episodes_per_scene // GROUP)
    rng = np.random.default_rng([config.seed, update])
    scenes: list[str | Scene] = []
    for game in config.training_games:
        pool = variations(game, config.variations, config.seed + STREAM, config.added_blocks)
        drawn = rng.integers(len(pool), size=groups - 1)
        scenes += [game, *(pool[k] for k in drawn)] if groups > 1 else [pool[int(rng.integers(len(pool)))]]
    return scenes, config.episodes_per_scene // groups


@cache
def variations(game: str, count: int, seed: int, added_blocks: int = 0) -> tuple[Scene, ...]:
    """About so many variations of a game, as many with each number of added blocks; not valid ones are left out.

    Raises:
        ValueError: none of them is valid; one line.
    """
    scene = load_scene(game)
    each, most = -(-count // (added_blocks + 1)), min(added_blocks, MAX_OBJECTS - scene.n_objects)
    for strength in STRENGTHS:
        found: list[Scene] = []
        for extra in range(most + 1):
            found += vary(
                scene,
                each,
                seed=seed + extra,
                shift_px=SHIFT * strength,
                scale_by=SCALE**strength,
                jitter_px=JITTER * strength,
                extra_blocks=extra,
            ).scenes
        if found:
            return tuple(found)
    raise ValueError(f"variations: expected some valid ones of {game}, got none of {count}")

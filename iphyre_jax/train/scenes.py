"""The scenes of a round: the training games, or variations of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain, islice
from typing import Final

import numpy as np

from iphyre_jax.scenes import MAX_OBJECTS, Scene, load_scene, vary
from iphyre_jax.train.settings.run import TrainConfig

GROUP: Final = 32  # episodes of one variation that are compared with one another
SHIFT, SCALE, JITTER = 60.0, 1.05, 8.0  # px, factor, px: the most that a variation differs by
TRIES: Final = 200  # draws of a variation, at most; of angle's, the most often refused, one in 100 is valid
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
    """So many valid variations of a game, about as many with each number of added blocks; fewer after TRIES draws each.

    Raises:
        ValueError: one line; there are none.
    """
    scene = load_scene(game)
    numbers = range(min(added_blocks, MAX_OBJECTS - scene.n_objects) + 1)
    each = -(-count // len(numbers))
    found = tuple(one for extra in numbers for one in _valid(scene, each, seed + extra, extra))
    if not found:
        raise ValueError(f"variations: expected some valid ones of {game}, got none of {count * TRIES}")
    return found


def _valid(scene: Scene, count: int, seed: int, extra_blocks: int) -> Iterator[Scene]:
    """So many valid variations: what is refused is drawn again, as objects that touch seldom move without overlap."""
    drawn = (
        vary(
            scene,
            count,
            seed=seed + k * STREAM,
            shift_px=SHIFT,
            scale_by=SCALE,
            jitter_px=JITTER,
            extra_blocks=extra_blocks,
        ).scenes
        for k in range(TRIES)
    )
    return islice(chain.from_iterable(drawn), count)  # draws no more than it needs

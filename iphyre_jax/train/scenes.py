"""The scenes of an update: the training games, or variations of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain, islice
from typing import Final

import numpy as np

from iphyre_jax.scenes import MAX_OBJECTS, Scene, load_scene, vary
from iphyre_jax.train.settings.run import TrainConfig

GROUP: Final = 32  # episodes of one variation, which are compared with one another
SHIFT, SCALE, JITTER = 60.0, 1.05, 8.0  # px, factor, px: the most that a variation differs by
TRIES: Final = 200  # draws of a variation at most; angle has the fewest valid ones, one in 100
STREAM: Final = 7919  # added to the seed, so that variations draw other numbers than anything else


def training_scenes(config: TrainConfig, update: int) -> tuple[Sequence[str | Scene], int]:
    """The scenes of an update, game by game, and the number of episodes of each.

    Without variations these are the games. With them, a game shares its episodes with variations of it, about GROUP
    episodes each. Seed and update decide which.
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


@lru_cache(256)
def variations(game: str, count: int, seed: int, added_blocks: int = 0) -> tuple[Scene, ...]:
    """`count` valid variations of a game, spread evenly over the numbers of added blocks; fewer after TRIES draws each.

    Raises:
        ValueError: one line; there are none.
    """
    scene = load_scene(game)
    numbers = range(min(added_blocks, MAX_OBJECTS - scene.n_objects) + 1)
    share = -(-count // len(numbers))
    valid = tuple(one for extra in numbers for one in _valid(scene, share, seed + extra, extra))
    if not valid:
        raise ValueError(f"variations: expected valid ones of {game}, got none in {count * TRIES} draws")
    return valid


def _valid(scene: Scene, count: int, seed: int, extra_blocks: int) -> Iterator[Scene]:
    """Valid variations; invalid ones are drawn again, since objects that touch seldom move without overlap."""
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
    return islice(chain.from_iterable(drawn), count)  # draws only what it needs

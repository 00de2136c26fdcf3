"""The scenes of an update: the training games, or variations of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import chain, islice
from typing import Final

import numpy as np

from iphyre_jax.data.named.varied import JITTER, SCALE, SHIFT
from iphyre_jax.scenes import MAX_OBJECTS, Scene, load_scene, vary
from iphyre_jax.train.settings.run import TrainConfig

TRIES: Final = 200  # draws of a variation at most; angle has the fewest valid ones, one in 100
STREAM: Final = 7919  # added to the seed, so that variations draw other numbers than anything else


def training_scenes(config: TrainConfig, update: int) -> tuple[Sequence[str | Scene], int]:
    """The scenes of an update but those of the pool, game by game, and the number of episodes of each.

    Without variations these are the games. With them, a game shares its episodes with variations of it, about GROUP
    episodes each; where they are too few to share, it or a variation is played, each in half of the updates. Seed and
    update decide which. A pool gets its share of every game's groups.
    """
    groups, left = config.groups, config.pool_groups
    rng = np.random.default_rng([config.seed, update])
    scenes = (_of_game(config, game, groups - left, rng) for game in config.training_games)
    return tuple(chain.from_iterable(scenes)), config.episodes_per_scene // groups


def _of_game(config: TrainConfig, game: str, own: int, rng: np.random.Generator) -> Sequence[str | Scene]:
    """The scenes of a game's own groups: the game and variations of it, or without any the game again and again."""
    if not config.variations or not own:
        return [game] * own
    pool = variations(game, config.variations, config.seed + STREAM, config.added_blocks)
    if own == 1:
        return [game if rng.integers(2) else pool[int(rng.integers(len(pool)))]]
    return [game, *(pool[k] for k in rng.integers(len(pool), size=own - 1))]


@lru_cache(256)
def variations(game: str, count: int, seed: int, added_blocks: int = 0) -> tuple[Scene, ...]:
    """About `count` valid variations of a game, as many for each number of added blocks.

    A few more where that does not divide evenly, fewer where TRIES draws for each were not enough.

    Raises:
        ValueError: one line; there are none.
    """
    scene = load_scene(game)
    numbers = range(min(added_blocks, MAX_OBJECTS - scene.n_objects) + 1)
    share = -(-count // len(numbers))
    # Seeds far apart: a layout is drawn before its added blocks, and neighbouring runs should share none.
    valid = tuple(one for extra in numbers for one in _valid(scene, share, seed + (extra << 40), extra))
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

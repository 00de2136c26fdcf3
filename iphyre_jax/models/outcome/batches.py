"""Which plays each batch of an epoch has."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from iphyre_jax.models.outcome.plays.inputs import Examples
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.scenes import SPLITS


def steps_per_epoch(config: OutcomeConfig, plays: int) -> int:
    """Batches of an epoch; the last one may be smaller."""
    return -(-(config.draws or plays) // config.batch_size)


def epoch_batches(config: OutcomeConfig, key: jax.Array, train: Examples, scenes: int) -> tuple[jax.Array, jax.Array]:
    """Plays of each batch, and which of them count.

    Args:
        config: settings.
        key: random numbers.
        train: N plays to learn from.
        scenes: number of their scenes.

    Returns:
        Two arrays (steps, B), or (steps, B, P) with P plays of a scene in a row.
    """
    steps = steps_per_epoch(config, len(train.label))
    if not config.draws:
        return _every_play_once(config, key, len(train.label), steps)
    index = _drawn(config, key, train, scenes, steps)
    return index, jnp.ones(index.shape)


def _every_play_once(config: OutcomeConfig, key: jax.Array, plays: int, steps: int) -> tuple[jax.Array, jax.Array]:
    """The plays in a random order; the last batch is filled up."""
    size = steps * config.batch_size
    index = jnp.pad(jax.random.permutation(key, plays), (0, size - plays))
    counts = (jnp.arange(size) < plays).astype(jnp.float32)
    return index.reshape(steps, -1), counts.reshape(steps, -1)


def _drawn(config: OutcomeConfig, key: jax.Array, train: Examples, scenes: int, steps: int) -> jax.Array:
    """P plays of each drawn scene, (steps, B, P), or (steps, B) for one; each solves it with equal chance, or fails.

    Every scene has a play, some have only such as fail. The play is drawn by its number: sums of the weights of
    millions of plays are too coarse in float32.
    """
    kind = 2 * jnp.asarray(train.game) + jnp.asarray(train.label)
    order, count = jnp.argsort(kind), jnp.bincount(kind, length=2 * scenes)
    first = jnp.cumsum(count) - count
    scene_key, kind_key, play_key = jax.random.split(key, 3)
    shape = (steps, config.batch_size // config.plans_per_scene, config.plans_per_scene)
    scene = jax.random.randint(scene_key, (*shape[:2], 1), 0, scenes)
    if config.basic_share:
        own_key, share_key = jax.random.split(jax.random.fold_in(scene_key, 1))
        own = jax.random.randint(own_key, scene.shape, 0, len(SPLITS["basic"]))
        scene = jnp.where(jax.random.bernoulli(share_key, config.basic_share, scene.shape), own, scene)
    wanted = 2 * scene + jax.random.bernoulli(kind_key, 0.5, shape)
    wanted = jnp.where(count[wanted] > 0, wanted, wanted ^ 1)
    drawn = jnp.floor(jax.random.uniform(play_key, shape) * count[wanted]).astype(jnp.int32)
    index = order[first[wanted] + jnp.minimum(drawn, count[wanted] - 1)]
    return index if config.plans_per_scene > 1 else index[..., 0]

"""Which plays each batch of an epoch has."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from iphyre_jax.models.outcome.plays.inputs import Examples
from iphyre_jax.models.outcome.settings import OutcomeConfig


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
    if config.plans_per_scene > 1:
        index = _grouped(config, key, train, scenes, steps)
        return index, jnp.ones(index.shape)
    return _one_by_one(config, key, jnp.asarray(train.weight), steps)


def _one_by_one(config: OutcomeConfig, key: jax.Array, weight: jax.Array, steps: int) -> tuple[jax.Array, jax.Array]:
    """Every play once, the last batch filled up; or, with `draws`, plays drawn by their weights."""
    plays, size = len(weight), steps * config.batch_size
    if config.draws:
        sums = jnp.cumsum(weight)
        drawn = jnp.searchsorted(sums, jax.random.uniform(key, (size,)) * sums[-1])
        index, counts = jnp.minimum(drawn, plays - 1), jnp.ones(size)
    else:
        index = jnp.pad(jax.random.permutation(key, plays), (0, size - plays))
        counts = (jnp.arange(size) < plays).astype(jnp.float32)
    return index.reshape(steps, -1), counts.reshape(steps, -1)


def _grouped(config: OutcomeConfig, key: jax.Array, train: Examples, scenes: int, steps: int) -> jax.Array:
    """P plays of each drawn scene, (steps, B, P); each is a solved or a failed one with equal chance, if it has both.

    Every scene has a play. The counts stand for `weight`: sums of millions of weights are too coarse in float32.
    """
    kind = 2 * jnp.asarray(train.game) + jnp.asarray(train.label)
    order, count = jnp.argsort(kind), jnp.bincount(kind, length=2 * scenes)
    first = jnp.cumsum(count) - count
    scene_key, kind_key, play_key = jax.random.split(key, 3)
    shape = (steps, config.batch_size // config.plans_per_scene, config.plans_per_scene)
    scene = jax.random.randint(scene_key, (*shape[:2], 1), 0, scenes)
    wanted = 2 * scene + jax.random.bernoulli(kind_key, 0.5, shape)
    wanted = jnp.where(count[wanted] > 0, wanted, wanted ^ 1)
    drawn = jnp.floor(jax.random.uniform(play_key, shape) * count[wanted]).astype(jnp.int32)
    return order[first[wanted] + jnp.minimum(drawn, count[wanted] - 1)]

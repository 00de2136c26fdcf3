"""Our outcome classifier: objects attend to one another, with the relations of all pairs, also those of their times."""

from __future__ import annotations

import math
from typing import NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp

from iphyre_jax.models.outcome.plays.inputs import Plans, Scenes
from iphyre_jax.observations.official import LENGTH_COLUMNS
from iphyre_jax.train.algos.networks import AttentionBlock, object_features, pair_features

PERIODS = (16.0, 8.0, 4.0, 2.0, 1.0, 0.5)  # s, of the sines of a time
SPANS = (0.2, 1.0, 4.0)  # s, over which a difference of two times saturates
STAYS = 16.0  # s, when a block goes that never does, as others see it
NEAR = 20.0  # px of the scene / 600: gaps beyond some of these count as far
SURE = 1e-6  # least chance of success and of failure


class RelationNetwork(nn.Module):
    """A plan solves a scene if every ball comes down: each ball has a chance of its own, and theirs are multiplied.

    Attributes:
        width: features of each object.
        rounds: of attention.
    """

    width: int
    rounds: int

    @nn.compact
    def __call__(self, rows: jax.Array, plans: Plans, scenes: Scenes, game: jax.Array) -> jax.Array:
        """Rows (B, 12, 9) and plans (B, 12), times in seconds -> logits (B, 2) of failure and success."""
        del scenes, game  # what an object is counts, not which scene it is from
        objects, pairs, mask, ball = describe(rows)
        pairs = jnp.concatenate([pairs, order(plans)], axis=-1)
        x = nn.relu(nn.Dense(self.width)(jnp.concatenate([objects, time_features(plans)], axis=-1)))
        for _ in range(self.rounds):
            x = AttentionBlock(self.width)(x, pairs, mask)
        count = jnp.maximum(mask.sum(axis=1), 1)[:, None]
        pooled = jnp.where(mask[..., None], x, 0.0).sum(axis=1) / count
        pooled = jnp.broadcast_to(pooled[:, None], x.shape)
        hidden = nn.relu(nn.Dense(self.width)(nn.LayerNorm()(jnp.concatenate([x, pooled], axis=-1))))
        return all_solved(nn.Dense(1)(hidden)[..., 0], ball)


class Described(NamedTuple):
    """What a table of objects says, whatever the plan."""

    objects: jax.Array  # (B, 12, F) features of each object
    pairs: jax.Array  # (B, 12, 12, R) of each pair
    mask: jax.Array  # (B, 12) bool: there is an object
    ball: jax.Array  # (B, 12) bool: it is a ball


def describe(rows: jax.Array) -> Described:
    """Features of scenes from their tables, (B, 12, 9)."""
    flags = jnp.minimum(rows[..., LENGTH_COLUMNS:], 1.0)
    seen = jnp.concatenate([rows[..., :LENGTH_COLUMNS], flags], axis=-1)
    mask = rows[..., 4] > 0  # every object has a radius
    ball = mask & (jnp.abs(rows[..., 0:2] - rows[..., 2:4]).max(axis=-1) < 1e-6)
    objects = jnp.concatenate([object_features(seen, seen[..., :0]), ball[..., None]], axis=-1)
    pairs = jnp.concatenate([pair_features(seen), near_features(seen), link_features(rows)], axis=-1)
    return Described(objects, pairs, mask, ball)


def all_solved(logits: jax.Array, ball: jax.Array) -> jax.Array:
    """Logits (..., 2) of failure and success from those of each object (..., 12), of which only balls count."""
    chance = jnp.where(ball, jax.nn.log_sigmoid(logits), 0.0).sum(axis=-1)
    chance = jnp.clip(chance, math.log(SURE), math.log1p(-SURE))
    return jnp.stack([jnp.log(-jnp.expm1(chance)), chance], axis=-1)


def time_features(plans: Plans) -> jax.Array:
    """(B, 12, F) whether each object is removed, and when: its time and sines of it."""
    time, removed = plans.seconds[..., None], plans.removed[..., None]
    angle = time * (2 * math.pi / jnp.asarray(PERIODS).reshape(1, 1, -1))
    each = [jnp.ones_like(time), time / 8, jnp.exp(-time), jnp.sin(angle), jnp.cos(angle)]
    return jnp.concatenate(each, axis=-1) * removed


def order(plans: Plans) -> jax.Array:
    """(B, 12, 12, 5) how much later than object n object m is removed, which goes first, whether both go."""
    when = jnp.where(plans.removed > 0, plans.seconds, STAYS)
    later = (when[:, None, :] - when[:, :, None])[..., None]
    both = (plans.removed[:, None, :] * plans.removed[:, :, None])[..., None]
    return jnp.concatenate([*(jnp.tanh(later / span) for span in SPANS), jnp.sign(later), both], axis=-1)


def link_features(rows: jax.Array) -> jax.Array:
    """(B, 12, 12, 2) whether a joint, whether a spring ties two objects: they have its number."""
    number = rows[..., 7:9]
    tied = (number[:, :, None] == number[:, None, :]) & (number[:, :, None] > 0)
    return tied.astype(jnp.float32)


def near_features(rows: jax.Array) -> jax.Array:
    """(B, 12, 12, 4) from n's centre to the nearest point of m's axis, and how close their surfaces are."""
    centre = ((rows[..., 0:2] + rows[..., 2:4]) / 2)[:, :, None]
    start, axis = rows[:, None, :, 0:2], (rows[..., 2:4] - rows[..., 0:2])[:, None]
    length = jnp.maximum(jnp.square(axis).sum(axis=-1, keepdims=True), 1e-9)
    along = jnp.clip(((centre - start) * axis).sum(axis=-1, keepdims=True) / length, 0.0, 1.0)
    apart = start + along * axis - centre
    distance = jnp.sqrt(jnp.square(apart).sum(axis=-1, keepdims=True) + 1e-12)
    gap = (distance - rows[:, :, None, 4:5] - rows[:, None, :, 4:5]) * (600.0 / NEAR)
    return jnp.concatenate([apart * 3, jnp.exp(-jnp.maximum(gap, 0.0)), jnp.exp(-jnp.maximum(gap, 0.0) / 4)], axis=-1)

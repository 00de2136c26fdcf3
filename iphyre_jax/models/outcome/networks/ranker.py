"""A classifier that judges many plans of a scene: the scene is encoded once, each plan by a smaller network.

To choose among samples of a policy (best of N with a learned verifier) takes dozens of judgements of one scene.
"""

from __future__ import annotations

from typing import Final

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.models.outcome.networks.relations import all_solved, describe
from iphyre_jax.models.outcome.plays.inputs import Plans, Scenes
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.train.algos.networks import AttentionBlock
from iphyre_jax.train.settings.agents import ATTENTION_HEADS

PLAN_WIDTH: Final = 64  # features of an object in a plan
PLAN_ROUNDS: Final = 2  # of attention, with the plan known
CENTRES: Final = {0.2: 48, 0.6: 24, 2.0: 8}  # width in s -> bumps of time; early ones are closer together


class RankerNetwork(nn.Module):
    """Objects attend to one another without a plan, then each plan's times are added and they attend again.

    Attributes:
        width: features of each object without a plan.
        rounds: of attention without a plan.
    """

    width: int
    rounds: int

    @nn.compact
    def __call__(self, rows: jax.Array, plans: Plans, scenes: Scenes, game: jax.Array) -> jax.Array:
        """Logits of failure and success.

        Args:
            rows: (B, 12, 9), scenes.
            plans: (B, 12) a plan of each scene, or (B, P, 12) P plans of each, times in seconds.
            scenes: not read: what an object is counts, not which scene it is from.
            game: not read.

        Returns:
            (B, 2) or (B, P, 2).
        """
        del scenes, game
        if single := plans.seconds.ndim == 2:
            plans = Plans(*(part[:, None] for part in plans))
        objects, pairs, mask, ball = describe(rows)
        x = nn.relu(nn.Dense(self.width)(objects))
        for _ in range(self.rounds):
            x = AttentionBlock(self.width)(x, pairs, mask)
        shift, scale = (nn.Dense(PLAN_WIDTH, use_bias=False)(bumps(plans)) for _ in range(2))
        base, gate = (nn.Dense(PLAN_WIDTH)(x)[:, None] for _ in range(2))
        y = nn.relu(base + shift + gate * scale)
        for _ in range(PLAN_ROUNDS):
            y = PlanAttention()(y, pairs, mask)
        pooled = jnp.where(mask[:, None, :, None], y, 0.0).sum(axis=2, keepdims=True)
        pooled = pooled / jnp.maximum(mask.sum(axis=1), 1)[:, None, None, None]
        y = jnp.concatenate([y, jnp.broadcast_to(pooled, y.shape)], axis=-1)
        logits = all_solved(nn.Dense(1)(nn.relu(nn.Dense(PLAN_WIDTH)(y)))[..., 0], ball[:, None])
        return logits[:, 0] if single else logits


class PlanAttention(nn.Module):
    """Attention of a scene's objects in each of P plans; what the pairs are weighs alike in all of them."""

    @nn.compact
    def __call__(self, x: jax.Array, pairs: jax.Array, mask: jax.Array) -> jax.Array:
        """Objects x (B, P, 12, d), features of pairs (B, 12, 12, r), mask (B, 12) -> (B, P, 12, d)."""
        width = x.shape[-1]
        each = width // ATTENTION_HEADS
        y = nn.LayerNorm()(x)
        query, key, value = (nn.DenseGeneral((ATTENTION_HEADS, each))(y) for _ in range(3))
        relation = nn.Dense(ATTENTION_HEADS)(nn.relu(nn.Dense(32)(pairs)))[:, None]
        score = jnp.einsum("bpnhe,bpmhe->bpnmh", query, key) / each**0.5 + relation
        weight = jax.nn.softmax(jnp.where(mask[:, None, None, :, None], score, -1e9), axis=3)
        attended = jnp.einsum("bpnmh,bpmhe->bpnhe", weight, value).reshape(x.shape)
        x = x + nn.Dense(width)(attended)
        return x + nn.Dense(width)(nn.relu(nn.Dense(2 * width)(nn.LayerNorm()(x))))


def bumps(plans: Plans) -> jax.Array:
    """(..., 12, F) whether each object is removed, and when: Gaussian bumps over time, finer for early times."""
    centre = np.concatenate(
        [np.geomspace(0.1, TIME_LIMIT - 0.1, count, dtype=np.float32) for count in CENTRES.values()]
    )
    width = np.repeat(np.array(list(CENTRES), np.float32), list(CENTRES.values()))
    centre, width = (numbers.reshape(*(1,) * plans.seconds.ndim, -1) for numbers in (centre, width))
    near = jnp.exp(-0.5 * jnp.square((plans.seconds[..., None] - centre) / width))
    linear = (plans.seconds / TIME_LIMIT)[..., None]
    each = jnp.concatenate([jnp.ones_like(linear), linear, near], axis=-1)
    return each * plans.removed[..., None]

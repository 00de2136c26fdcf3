"""Networks: from observations to the outputs of an action head or a value."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from iphyre_jax.train.observations import filled_slots, parts
from iphyre_jax.train.settings.agents import ATTENTION_HEADS
from iphyre_jax.train.settings.run import TrainConfig

Params = Any  # a network's tree of arrays

POLICY_SCALE = 0.01  # small last layer: the first policy is the action head's prior, for every scene
VALUE_SCALE = 1.0
NOTHING: Any = ()  # stands for arrays that a state does not have
CONTRAST = 2.0  # factor of centred observations
SAME_PLACE = 1e-3  # of the screen: an object nearer than this to a slot's centre is its block

ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {"tanh": nn.tanh, "relu": nn.relu}


def _dense(width: int, scale: float) -> nn.Dense:
    return nn.Dense(width, kernel_init=nn.initializers.orthogonal(scale))


class MLP(nn.Module):
    """Multilayer perceptron: one list of numbers in.

    Attributes:
        hidden_sizes: widths of the hidden layers.
        activation: "tanh" or "relu".
        shape: of the outputs.
        scale: of the last layer's weights at the start.
        dueling: compute a value and each output's deviation from their mean as two streams.
        center_obs: subtract the mean of the observations that the network is initialised with.
    """

    hidden_sizes: Sequence[int]
    activation: str
    shape: tuple[int, ...]
    scale: float
    dueling: bool = False
    center_obs: bool = False

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        """(B, D) float32 observations -> (B, *shape) float32."""
        x = obs
        if self.center_obs:  # games look much alike: else what is learned from one holds for all
            center = self.param("centre", lambda _: obs.mean(axis=0, keepdims=True))
            x = CONTRAST * (x - jax.lax.stop_gradient(center))
        for width in self.hidden_sizes:
            x = ACTIVATIONS[self.activation](_dense(width, 2.0**0.5)(x))
        outputs = _dense(math.prod(self.shape), self.scale)(x)
        if self.dueling:
            outputs = outputs - outputs.mean(axis=-1, keepdims=True) + _dense(1, self.scale)(x)
        return outputs.reshape(x.shape[0], *self.shape)


class ObjectNetwork(nn.Module):
    """Objects attend to one another. What an object is counts, not its row.

    Attributes:
        hidden_sizes: widths of the attention blocks.
        shape: of the outputs: (6, K) for times of the slots, (7,) for no-op and slots, () for a value.
        scale: of the last layer's weights at the start.
    """

    hidden_sizes: Sequence[int]
    shape: tuple[int, ...]
    scale: float

    @nn.compact
    def __call__(self, obs: jax.Array) -> jax.Array:
        """(B, D) float32 observations -> (B, *shape) float32."""
        rows, candidates, motion, _ = parts(obs)
        mask = rows[..., 4] > 0  # every object has a radius
        relations = pair_features(rows)
        x = nn.relu(_dense(self.hidden_sizes[0], 2.0**0.5)(object_features(rows, motion)))
        for k, width in enumerate(self.hidden_sizes):
            # flax draws initial weights by the name of a module: this one keeps those of earlier versions.
            x = AttentionBlock(width, name=f"_Round_{k}")(x, relations, mask)
        pooled = jnp.where(mask[..., None], x, 0.0).sum(axis=1) / jnp.maximum(mask.sum(axis=1), 1)[:, None]
        if self.shape == ():
            return _dense(1, self.scale)(pooled)[..., 0]
        slots = jnp.einsum("bsn,bnd->bsd", _slot_objects(rows, candidates), x)
        if len(self.shape) == 2:
            return _dense(self.shape[1], self.scale)(slots)
        return jnp.concatenate([_dense(1, self.scale)(pooled), _dense(1, self.scale)(slots)[..., 0]], axis=-1)


class AttentionBlock(nn.Module):
    """Attention with the features of all pairs as a bias and as a message, then a layer for each object.

    Attributes:
        width: number of features of each object.
    """

    width: int

    @nn.compact
    def __call__(self, x: jax.Array, pair_features: jax.Array, mask: jax.Array) -> jax.Array:
        """Objects x (B, 12, d), pair features (B, 12, 12, r), mask (B, 12) -> (B, 12, width)."""
        each = self.width // ATTENTION_HEADS
        y = nn.LayerNorm()(x)
        query, key, value = (nn.DenseGeneral((ATTENTION_HEADS, each))(y) for _ in range(3))
        relation = nn.Dense(ATTENTION_HEADS)(nn.relu(nn.Dense(32)(pair_features)))
        score = jnp.einsum("bnhe,bmhe->bnmh", query, key) / each**0.5 + relation
        weight = jax.nn.softmax(jnp.where(mask[:, None, :, None], score, -1e9), axis=2)
        attended_values = jnp.einsum("bnmh,bmhe->bnhe", weight, value).reshape(*x.shape[:2], -1)
        attended_pairs = jnp.einsum("bnmh,bnmr->bnhr", weight, pair_features).reshape(*x.shape[:2], -1)
        x = nn.Dense(self.width)(x) + nn.Dense(self.width)(jnp.concatenate([attended_values, attended_pairs], axis=-1))
        return x + nn.Dense(self.width)(nn.relu(_dense(2 * self.width, 2.0**0.5)(nn.LayerNorm()(x))))


def _centres(rows: jax.Array) -> jax.Array:
    """(B, 12, 2) centres of the objects."""
    return (rows[..., 0:2] + rows[..., 2:4]) / 2


def object_features(rows: jax.Array, motion: jax.Array) -> jax.Array:
    """(B, 12, F) features of each object: centre, half axis in both directions, length, radius, flags; motion, time."""
    half = (rows[..., 2:4] - rows[..., 0:2]) / 2
    length = jnp.sqrt(jnp.square(half).sum(axis=-1, keepdims=True) + 1e-12)
    turned = half * jnp.sign(half[..., :1] + 1e-9)  # a bar is the same from either end
    each = [_centres(rows) * 2 - 1, turned * 4, jnp.abs(half) * 4, length * 4, rows[..., 4:5] * 30, rows[..., 5:]]
    if motion.shape[-1]:
        each.append(motion[..., :-1].reshape(*rows.shape[:2], -1))
        each.append(jnp.broadcast_to(motion[..., None, -1:], (*rows.shape[:2], 1)))
    return jnp.concatenate(each, axis=-1)


def pair_features(rows: jax.Array) -> jax.Array:
    """(B, 12, 12, 7) where m's centre and both its ends lie, seen from object n, and how near."""
    centre = _centres(rows)[:, :, None, :]
    others = [_centres(rows), rows[..., 0:2], rows[..., 2:4]]
    apart = [(other[:, None, :, :] - centre) * 3 for other in others]
    far = jnp.sqrt(jnp.square(apart[0]).sum(axis=-1, keepdims=True) + 1e-12)
    return jnp.concatenate([*apart, jnp.exp(-far)], axis=-1)


def _slot_objects(rows: jax.Array, candidates: jax.Array) -> jax.Array:
    """(B, 6, 12) 1 where an object is the block of a slot, all 0 once it is removed. Such blocks never move.

    Ends and centres are clipped to the picture. If an end is at its edge, the centre is anywhere between the ends.
    """
    ends, centre = jnp.stack([rows[:, None, :, 0:2], rows[:, None, :, 2:4]]), candidates[:, :, None]
    away = jnp.abs(_centres(rows)[:, None] - centre)
    outside = jnp.maximum(ends.min(axis=0) - centre, centre - ends.max(axis=0))
    between = jnp.where(((ends == 0) | (ends == 1)).any(axis=0), outside, away)
    possible = (rows[..., 5] > 0)[:, None, :] & filled_slots(candidates)[:, :, None]
    exact, clipped = (possible & (far.max(axis=-1) < SAME_PLACE) for far in (away, between))
    return (exact | clipped & ~exact.any(axis=1, keepdims=True)).astype(jnp.float32)


def network(config: TrainConfig, shape: tuple[int, ...], scale: float, *, dueling: bool = False) -> nn.Module:
    """The network of a configuration with outputs of a shape."""
    if config.network == "objects":
        return ObjectNetwork(config.hidden_sizes, shape, scale)
    return MLP(config.hidden_sizes, config.activation, shape, scale, dueling, config.center_obs)

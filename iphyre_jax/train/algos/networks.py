"""Networks: from observations to what an action head or a value asks for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from iphyre_jax.train.observations import parts
from iphyre_jax.train.settings.run import TrainConfig

Params = Any  # a network's tree of arrays

POLICY_SCALE = 0.01  # small last layer: the first policy is the action head's prior, for every scene
VALUE_SCALE = 1.0
NOTHING: Any = ()  # in place of arrays that are not there
CONTRAST = 2.0  # factor of centred observations
SAME_PLACE = 1e-3  # of the screen: nearer than this, an object stands where a slot's block does
HEADS = 4  # of attention

ACTIVATIONS: dict[str, Callable[[jax.Array], jax.Array]] = {"tanh": nn.tanh, "relu": nn.relu}


def _dense(width: int, scale: float) -> nn.Dense:
    return nn.Dense(width, kernel_init=nn.initializers.orthogonal(scale))


class Perceptron(nn.Module):
    """Multilayer perceptron.

    Attributes:
        hidden: widths of the hidden layers.
        activation: "tanh" or "relu".
        shape: of the outputs.
        scale: of the last layer's weights at the start.
        dueling: the last layer as a value and the deviations of each output from their mean.
        centred: the mean of the observations that it is initialised with is subtracted from all that come.
    """

    hidden: Sequence[int]
    activation: str
    shape: tuple[int, ...]
    scale: float
    dueling: bool = False
    centred: bool = False

    @nn.compact
    def __call__(self, observation: jax.Array) -> jax.Array:
        """(B, D) float32 observations -> (B, *shape) float32."""
        x = observation
        if self.centred:  # games look much alike: without this, what is learned of one holds for all of them
            centre = self.param("centre", lambda _: observation.mean(axis=0, keepdims=True))
            x = CONTRAST * (x - jax.lax.stop_gradient(centre))
        for width in self.hidden:
            x = ACTIVATIONS[self.activation](_dense(width, 2.0**0.5)(x))
        outputs = _dense(math.prod(self.shape), self.scale)(x)
        if self.dueling:
            outputs = outputs - outputs.mean(axis=-1, keepdims=True) + _dense(1, self.scale)(x)
        return outputs.reshape(x.shape[0], *self.shape)


class ObjectNetwork(nn.Module):
    """Objects that attend to one another, the same for each, so that it matters what they are and not in which row.

    Attributes:
        hidden: widths of the rounds of attention.
        shape: of the outputs: (6, K) for times of the slots, (7,) for no-op and slots, () for a value.
        scale: of the last layer's weights at the start.
    """

    hidden: Sequence[int]
    shape: tuple[int, ...]
    scale: float

    @nn.compact
    def __call__(self, observation: jax.Array) -> jax.Array:
        """(B, D) float32 observations -> (B, *shape) float32."""
        seen = parts(observation)
        there = seen.rows[..., 4] > 0  # every object has a radius
        near = _relations(seen.rows)
        x = nn.relu(_dense(self.hidden[0], 2.0**0.5)(_described(seen.rows, seen.motion)))
        for width in self.hidden:
            x = _Round(width)(x, near, there)
        pooled = jnp.where(there[..., None], x, 0.0).sum(axis=1) / jnp.maximum(there.sum(axis=1), 1)[:, None]
        if self.shape == ():
            return _dense(1, self.scale)(pooled)[..., 0]
        slots = jnp.einsum("bsn,bnd->bsd", _slot_objects(seen.rows, seen.candidates), x)
        if len(self.shape) == 2:
            return _dense(self.shape[1], self.scale)(slots)
        return jnp.concatenate([_dense(1, self.scale)(pooled), _dense(1, self.scale)(slots)[..., 0]], axis=-1)


class _Round(nn.Module):
    """One round of attention with the relations of all pairs as a bias and as a message, then a layer for each object.

    Attributes:
        width: of each object's description.
    """

    width: int

    @nn.compact
    def __call__(self, x: jax.Array, near: jax.Array, there: jax.Array) -> jax.Array:
        """Objects x (B, 12, d), near (B, 12, 12, r), there (B, 12) -> (B, 12, width)."""
        each = self.width // HEADS
        y = nn.LayerNorm()(x)
        query, key, value = (nn.DenseGeneral((HEADS, each))(y) for _ in range(3))
        relation = nn.Dense(HEADS)(nn.relu(nn.Dense(32)(near)))
        score = jnp.einsum("bnhe,bmhe->bnmh", query, key) / each**0.5 + relation
        weight = jax.nn.softmax(jnp.where(there[:, None, :, None], score, -1e9), axis=2)
        heard = jnp.einsum("bnmh,bmhe->bnhe", weight, value).reshape(*x.shape[:2], -1)
        felt = jnp.einsum("bnmh,bnmr->bnhr", weight, near).reshape(*x.shape[:2], -1)
        x = nn.Dense(self.width)(x) + nn.Dense(self.width)(jnp.concatenate([heard, felt], axis=-1))
        return x + nn.Dense(self.width)(nn.relu(_dense(2 * self.width, 2.0**0.5)(nn.LayerNorm()(x))))


def _centres(rows: jax.Array) -> jax.Array:
    """(B, 12, 2) centres of the objects."""
    return (rows[..., 0:2] + rows[..., 2:4]) / 2


def _described(rows: jax.Array, motion: jax.Array) -> jax.Array:
    """(B, 12, F) each object by itself: centre, half axis both ways round, length, radius, flags; motion and time."""
    half = (rows[..., 2:4] - rows[..., 0:2]) / 2
    length = jnp.sqrt(jnp.square(half).sum(axis=-1, keepdims=True) + 1e-12)
    turned = half * jnp.sign(half[..., :1] + 1e-9)  # a bar is the same from either end
    each = [_centres(rows) * 2 - 1, turned * 4, jnp.abs(half) * 4, length * 4, rows[..., 4:5] * 30, rows[..., 5:]]
    if motion.shape[-1]:
        each.append(motion[..., :-1].reshape(*rows.shape[:2], -1))
        each.append(jnp.broadcast_to(motion[..., None, -1:], (*rows.shape[:2], 1)))
    return jnp.concatenate(each, axis=-1)


def _relations(rows: jax.Array) -> jax.Array:
    """(B, 12, 12, 7) of object n to object m: where m's centre and its nearer and farther end lie, and how far."""
    centre = _centres(rows)[:, :, None, :]
    others = [_centres(rows), rows[..., 0:2], rows[..., 2:4]]
    apart = [(other[:, None, :, :] - centre) * 3 for other in others]
    far = jnp.sqrt(jnp.square(apart[0]).sum(axis=-1, keepdims=True) + 1e-12)
    return jnp.concatenate([*apart, jnp.exp(-far)], axis=-1)


def _slot_objects(rows: jax.Array, candidates: jax.Array) -> jax.Array:
    """(B, 6, 12) 1 where an object is the block of a slot, 0 for all if it is gone. Such blocks never move."""
    away = jnp.abs(_centres(rows)[:, None] - candidates[:, :, None]).max(axis=-1)
    block = (rows[..., 5] > 0)[:, None, :]
    return (block & (away < SAME_PLACE)).astype(jnp.float32)


def network(config: TrainConfig, shape: tuple[int, ...], scale: float, *, dueling: bool = False) -> nn.Module:
    """The network of a configuration with outputs of a shape."""
    if config.network == "objects":
        return ObjectNetwork(config.hidden, shape, scale)
    return Perceptron(config.hidden, config.activation, shape, scale, dueling, config.centred)

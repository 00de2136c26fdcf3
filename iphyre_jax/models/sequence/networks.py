"""The network: a causal transformer over tokens of returns, states and actions.

A sequence of T decisions is 3 T tokens in the order of time: return, state, action, return, ... A decision is read off
its state's token, which sees everything before it and no action of its own. Shapes: B sequences, T decisions, A numbers
of an action, W numbers of a token.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp

from iphyre_jax.models.outcome.networks.relations import describe
from iphyre_jax.models.sequence.settings import SequenceConfig
from iphyre_jax.rules import FRAMES
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS
from iphyre_jax.train.algos.networks import AttentionBlock
from iphyre_jax.train.observations import filled_slots

NEVER_BIN: Final = FRAMES  # the time of a block that stays, in tenths of a second
END: Final = MAX_OBJECTS  # the event after the last removal
OBJECT: Final = 64  # numbers of an object of ours
ROUNDS: Final = 2  # of attention among objects
NOWHERE: Final = -1e9  # logit of what cannot be chosen


class Sequences(NamedTuple):
    """B sequences of T decisions as a network sees them."""

    returns: jax.Array  # (B, T) rest of the reward / 1000 that is to come, or that is asked for
    rows: jax.Array  # (B, T, 12, 9) official tables, lengths / 600; or (B, 1, 12, 9): the start for all decisions
    centres: jax.Array  # (B, 6, 2) of the slots' blocks at the start / 600
    actions: jax.Array  # (B, T, A) int32; plans: tenths of a second of six slots; choices: 0..6; events: object, tenths
    time: jax.Array  # (B, T) int32, tenths of a second


class Logits(NamedTuple):
    """What a network gives at each decision."""

    choice: jax.Array  # plans: (B, T, 6, 151); choices: (B, T, 7); events: (B, T, 13), the object or END
    delay: jax.Array  # events: (B, T, 150), tenths of a second until the object of `actions` goes; else (B, T, 0)


class Block(nn.Module):
    """A layer of the transformer: causal attention, then two dense layers."""

    heads: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """(B, L, W) -> (B, L, W); output l depends on inputs up to l alone."""
        length, width = x.shape[1:]
        each = width // self.heads
        y = nn.LayerNorm()(x)
        query, key, value = (
            nn.Dense(width, name=name)(y).reshape(*y.shape[:2], self.heads, each) for name in ("query", "key", "value")
        )
        score = jnp.einsum("blhe,bmhe->bhlm", query, key) / each**0.5
        weight = jax.nn.softmax(jnp.where(jnp.tril(jnp.ones((length, length), bool)), score, NOWHERE), axis=-1)
        x = x + nn.Dense(width)(jnp.einsum("bhlm,bmhe->blhe", weight, value).reshape(x.shape))
        return x + nn.Dense(width)(nn.gelu(nn.Dense(4 * width)(nn.LayerNorm()(x))))


class SequenceModel(nn.Module):
    """See the module.

    Attributes:
        config: settings.
    """

    config: SequenceConfig

    @nn.compact
    def __call__(self, inputs: Sequences) -> Logits:
        """Logits of every decision."""
        config, width = self.config, self.config.width
        shape = inputs.returns.shape
        if config.form == "events":
            objects, mask = self._objects(inputs.rows)
            pooled = jnp.where(mask[..., None], objects, 0.0).sum(axis=2) / jnp.maximum(mask.sum(axis=2), 1)[..., None]
            state = nn.Dense(width)(pooled)
            which = jax.nn.one_hot(inputs.actions[..., 0], MAX_OBJECTS)
            picked = jnp.einsum("btn,btnd->btd", which, self._all(objects, shape))
            delay = nn.Embed(FRAMES, width)(jnp.clip(inputs.actions[..., 1], 0, FRAMES - 1))
            action = nn.Dense(width)(picked) + delay
        else:
            state = nn.Dense(width)(self._flat(inputs))
            action = nn.Dense(width)(self._action(inputs.actions))
        when = nn.Embed(FRAMES + 1, width, embedding_init=nn.initializers.normal(0.02))(inputs.time)
        returns = nn.Dense(width)(inputs.returns[..., None] * float(config.returns))
        tokens = jnp.stack([jnp.broadcast_to(part, when.shape) + when for part in (returns, state, action)], axis=2)
        x = tokens.reshape(shape[0], 3 * shape[1], width)
        for _ in range(config.layers):
            x = Block(config.heads)(x)
        features = nn.LayerNorm()(x.reshape(tokens.shape)[:, :, 1])
        if config.form == "events":
            return self._events(features, self._all(objects, shape), picked, inputs)
        if config.form == "choices":
            allowed = jnp.concatenate([jnp.ones((shape[0], 1), bool), filled_slots(inputs.centres)], axis=1)
            scores = nn.Dense(MAX_ELIMINABLE + 1)(features)
            return Logits(jnp.where(allowed[:, None], scores, NOWHERE), features[..., :0])
        each = nn.Dense(MAX_ELIMINABLE * (FRAMES + 1))(features)
        return Logits(each.reshape(*shape, MAX_ELIMINABLE, FRAMES + 1), features[..., :0])

    def _flat(self, inputs: Sequences) -> jax.Array:
        """The paper's state: the table and the centres, with the pair of the no-op on the fly."""
        before = inputs.rows.shape[:2]
        rows = jnp.minimum(inputs.rows, 1.0).reshape(*before, -1)
        centres = jnp.broadcast_to(inputs.centres.reshape(before[0], 1, -1), (*before, 2 * MAX_ELIMINABLE))
        return jnp.concatenate([rows, centres], axis=-1)

    def _action(self, actions: jax.Array) -> jax.Array:
        """Numbers of an action: times as shares of 15 s, or which of seven choices."""
        if self.config.form == "choices":
            return jax.nn.one_hot(actions[..., 0], MAX_ELIMINABLE + 1)
        return (actions % NEVER_BIN).astype(jnp.float32) / FRAMES  # never is 0, as in the official files

    def _objects(self, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Numbers of each object, (B, E, 12, OBJECT), from its relations to all others; and which are there."""
        each, pairs, mask, _ = describe(rows.reshape(-1, *rows.shape[2:]))
        x = nn.relu(nn.Dense(OBJECT)(each))
        for _ in range(ROUNDS):
            x = AttentionBlock(OBJECT)(x, pairs, mask)
        return x.reshape(*rows.shape[:3], OBJECT), mask.reshape(rows.shape[:3])

    def _all(self, objects: jax.Array, shape: tuple[int, ...]) -> jax.Array:
        """The objects at every decision, (B, T, 12, OBJECT)."""
        return jnp.broadcast_to(objects, (*shape, *objects.shape[2:]))

    def _events(self, features: jax.Array, objects: jax.Array, picked: jax.Array, inputs: Sequences) -> Logits:
        """Which object goes next, from each object and what has happened; then after how long."""
        both = nn.Dense(OBJECT)(objects) + nn.Dense(OBJECT)(features)[:, :, None]
        scores = nn.Dense(1)(nn.relu(both))[..., 0]
        removed = jax.nn.one_hot(inputs.actions[..., 0], MAX_OBJECTS)
        before = jnp.cumsum(removed, axis=1) - removed  # a block goes once
        able = (jnp.broadcast_to(inputs.rows[..., 5], before.shape) > 0) & (before < 0.5)
        end = nn.Dense(1)(features)
        choice = jnp.concatenate([jnp.where(able, scores, NOWHERE), end], axis=-1)
        width = self.config.width
        delay = nn.Dense(width)(features) + nn.Dense(width)(picked)
        return Logits(choice, nn.Dense(FRAMES)(nn.relu(nn.LayerNorm()(delay))))

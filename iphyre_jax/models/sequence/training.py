"""Training: one compiled function for every preset; models of several seeds one after the other, steps under `scan`."""

from __future__ import annotations

from functools import partial
from typing import Any, Final, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax

from iphyre_jax.models.outcome.training import mirror_rows
from iphyre_jax.models.sequence.episodes import SequenceData
from iphyre_jax.models.sequence.networks import NOWHERE, Logits, SequenceModel, Sequences
from iphyre_jax.models.sequence.settings import SequenceConfig
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES

CLIP: Final = 1.0  # norm of a gradient

Params = Any  # a network's tree of arrays


class SequenceState(NamedTuple):
    """What training changes; every array has an axis of seeds in front."""

    params: Params
    moments: Any  # of the optimiser


class Batch(NamedTuple):
    """B sequences to learn from."""

    inputs: Sequences
    weight: jax.Array  # (B, T, K)


def _optimizer(config: SequenceConfig) -> optax.GradientTransformation:
    rate = optax.warmup_cosine_decay_schedule(
        0.0, config.learning_rate, config.warm_up, max(config.updates, config.warm_up + 1), config.final_rate
    )
    return optax.chain(optax.clip_by_global_norm(CLIP), optax.adamw(rate, weight_decay=config.weight_decay))


def start(config: SequenceConfig, data: SequenceData) -> SequenceState:
    """The state before the first step."""
    index = jnp.zeros(1, jnp.int32)
    batch = take(config, jax.tree.map(jnp.asarray, data), index, index)

    def one(seed: jax.Array) -> SequenceState:
        params = SequenceModel(config).init(jax.random.key(seed), batch.inputs)
        return SequenceState(params, _optimizer(config).init(params))

    return cast(SequenceState, jax.jit(lambda: jax.lax.map(one, jnp.arange(config.seeds, dtype=jnp.uint32)))())


def take(config: SequenceConfig, data: SequenceData, index: jax.Array, first: jax.Array) -> Batch:
    """Sequences by their plays (B,) and first decisions (B,), each with `config.context` decisions."""
    decisions = data.returns.shape[1]
    which = jnp.minimum(first[:, None] + jnp.arange(min(config.context, decisions))[None], decisions - 1)

    def cut(array: Any) -> jax.Array:  # noqa: ANN401
        chosen = jnp.asarray(array)[index]
        at = which.reshape(*which.shape, *(1,) * (chosen.ndim - 2))
        return jnp.take_along_axis(chosen, at, axis=1)

    table = jnp.asarray(data.table)[index] if data.table.shape[1] == 1 else cut(data.table)
    inputs = Sequences(
        returns=cut(data.returns),
        rows=jnp.asarray(data.tables)[table],
        centres=jnp.asarray(data.centres)[jnp.asarray(data.scene)[index]],
        actions=cut(data.actions),
        time=cut(data.time),
    )
    return Batch(inputs, cut(data.weight))


def draw(config: SequenceConfig, data: SequenceData, key: jax.Array) -> Batch:
    """A batch of random sequences; of long ones a random part."""
    play_key, first_key, mirror_key = jax.random.split(key, 3)
    sums = jnp.cumsum(jnp.asarray(data.share))
    drawn = jnp.searchsorted(sums, jax.random.uniform(play_key, (config.batch_size,)) * sums[-1])
    index = jnp.minimum(drawn, len(sums) - 1)
    room = jnp.maximum(jnp.asarray(data.length)[index] - config.context + 1, 1)
    first = jnp.floor(jax.random.uniform(first_key, room.shape) * room).astype(jnp.int32)
    batch = take(config, data, index, first)
    if not config.mirrored:
        return batch
    which = jax.random.bernoulli(mirror_key, 0.5, index.shape)
    rows = jax.vmap(mirror_rows, in_axes=(1, None), out_axes=1)(batch.inputs.rows, which)
    return batch._replace(inputs=batch.inputs._replace(rows=rows))


def blurred(target: jax.Array, bins: int, smoothing: float) -> jax.Array:
    """Targets (...,) as distributions (..., bins): times blur over their neighbours, "never" (bin 150) does not.

    Args:
        target: int32.
        bins: 150 or 151.
        smoothing: s, standard deviation; 0: not at all.
    """
    if not smoothing:
        return jax.nn.one_hot(target, bins)
    away = (np.arange(FRAMES)[:, None] - np.arange(FRAMES)) / (smoothing * DECISIONS_PER_SECOND)
    kernel = np.eye(bins, dtype=np.float32)
    kernel[:FRAMES, :FRAMES] = np.exp(-0.5 * np.square(away))
    return jnp.asarray(kernel / kernel.sum(axis=1, keepdims=True))[target]


def log_likelihood(config: SequenceConfig, logits: Logits, actions: jax.Array, smoothing: float) -> jax.Array:
    """(B, T, K) how likely each part of each action (B, T, A) is, as a logarithm."""
    if config.form == "plans":
        target = blurred(actions, FRAMES + 1, smoothing)
        return (target * jax.nn.log_softmax(logits.choice)).sum(axis=-1)
    choice = jnp.take_along_axis(jax.nn.log_softmax(logits.choice), actions[..., :1], axis=-1)
    if config.form == "choices":
        return choice
    target = blurred(actions[..., 1], FRAMES, smoothing)
    delay = (target * jax.nn.log_softmax(logits.delay)).sum(axis=-1, keepdims=True)
    return jnp.concatenate([choice, delay], axis=-1)


def loss(config: SequenceConfig, params: Params, batch: Batch) -> jax.Array:
    """Weighted cross entropy.

    Of two blocks that go within 0.1 s the table after the first shows neither: the second cannot be chosen there, and
    is not learned.
    """
    logits = cast(Logits, SequenceModel(config).apply(params, batch.inputs))
    each = log_likelihood(config, logits, batch.inputs.actions, config.smoothing)
    learned = (batch.weight > 0) & ~(each <= NOWHERE / 2)  # NaN stays: it tells that training has diverged
    weight = jnp.where(learned, batch.weight, 0.0)
    return -(jnp.where(learned, each, 0.0) * weight).sum() / jnp.maximum(weight.sum(), 1e-9)


@partial(jax.jit, static_argnums=0)
def train_chunk(
    config: SequenceConfig, data: SequenceData, first: jax.Array, state: SequenceState
) -> tuple[SequenceState, jax.Array]:
    """Make the next `config.chunk` steps, of which `first` were made, with all seeds; the losses are (chunk, K)."""
    optimizer = _optimizer(config)

    def one(given: tuple[jax.Array, SequenceState]) -> tuple[SequenceState, jax.Array]:
        seed, before = given

        def step(state: SequenceState, number: jax.Array) -> tuple[SequenceState, jax.Array]:
            batch = draw(config, data, jax.random.fold_in(jax.random.key(seed), number + 1))
            value, gradient = jax.value_and_grad(partial(loss, config))(state.params, batch)
            updates, moments = optimizer.update(gradient, state.moments, state.params)
            return SequenceState(cast(Params, optax.apply_updates(state.params, updates)), moments), value

        return jax.lax.scan(step, before, first + jnp.arange(config.chunk))

    seeds = jnp.arange(config.seeds, dtype=jnp.uint32)
    after, losses = jax.lax.map(one, (seeds, state))
    return after, losses.T


def of_seed(params: Params, seed: int) -> Params:
    """The parameters of one model of several."""
    return jax.tree.map(lambda leaf: leaf[seed], params)

"""Training: one compiled function for every preset; seeds side by side under `vmap`, epochs under `scan`."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optax

from iphyre_jax.models.outcome.networks.fusion import network
from iphyre_jax.models.outcome.plays.inputs import Examples, Plans, Scenes
from iphyre_jax.models.outcome.settings import OutcomeConfig

BLOCK: Final = 2048  # plans judged at once

Params = Any  # a network's tree of arrays


class OutcomeState(NamedTuple):
    """What training changes; every array has an axis of seeds in front."""

    params: Params
    moments: Any  # of the optimiser
    best: Params  # parameters of the epoch with the least loss on held-out plays
    best_loss: jax.Array  # (K,) that loss
    best_epoch: jax.Array  # (K,) int32, epochs made by then


class History(NamedTuple):
    """What was measured after each epoch, (epochs, K) float32."""

    loss: jax.Array  # on the plays learned from, while learning
    held_loss: jax.Array  # on held-out plays
    held_accuracy: jax.Array


class Material(NamedTuple):
    """What training reads."""

    scenes: Scenes  # of the plays to learn from
    train: Examples
    held_scenes: Scenes
    held: Examples


def steps_per_epoch(config: OutcomeConfig, plays: int) -> int:
    """Batches of an epoch; the last one may be smaller."""
    return -(-(config.draws or plays) // config.batch_size)


def learning_rate(config: OutcomeConfig, steps: int) -> Callable[[Any], jax.Array]:
    """The rate at each step of a training of so many steps: half a cosine down, and up again if it swings."""
    half = config.half_period or steps
    low, high = config.final_rate, config.learning_rate

    def rate(step: Any) -> jax.Array:  # noqa: ANN401 - a number of any kind
        return jnp.asarray(low + (high - low) * (1 + jnp.cos(jnp.pi * step / half)) / 2)

    return rate


def _optimizer(config: OutcomeConfig, plays: int) -> optax.GradientTransformation:
    rate = learning_rate(config, config.epochs * steps_per_epoch(config, plays))
    if config.weight_decay:
        return optax.chain(optax.clip_by_global_norm(1.0), optax.adamw(rate, weight_decay=config.weight_decay))
    return optax.adam(rate)


def start(config: OutcomeConfig, material: Material) -> OutcomeState:
    """The state before the first epoch."""
    first = jax.tree.map(lambda leaf: jnp.asarray(leaf[:1]), material.train)

    def one(seed: jax.Array) -> OutcomeState:
        rows = jnp.asarray(material.scenes.rows)[first.game]
        params = network(config).init(jax.random.key(seed), rows, first.plans, material.scenes, first.game)
        moments = _optimizer(config, len(material.train.label)).init(params)
        return OutcomeState(params, moments, params, jnp.float32(math.inf), jnp.int32(0))

    return jax.jit(jax.vmap(one))(jnp.arange(config.seeds, dtype=jnp.uint32))


def logits(config: OutcomeConfig, params: Params, scenes: Scenes, game: jax.Array, plans: Plans) -> jax.Array:
    """Logits of failure and success, (B, 2), by one network."""
    return _apply(config, params, jnp.asarray(scenes.rows)[game], plans, scenes, game)


def _apply(
    config: OutcomeConfig,
    params: Params,
    rows: jax.Array,
    plans: Plans,
    scenes: Scenes,
    game: Any,  # noqa: ANN401
) -> jax.Array:
    return cast(jax.Array, network(config).apply(params, rows, plans, scenes, game))


def mirror_rows(rows: jax.Array, which: jax.Array) -> jax.Array:
    """Mirror left and right the tables (B, 12, 9) for which `which` (B,) is True; rows of no object stay zero."""
    there = rows[..., 4:5] > 0
    turned = jnp.concatenate([1 - rows[..., 0:1], rows[..., 1:2], 1 - rows[..., 2:3], rows[..., 3:]], axis=-1)
    return jnp.where(which[:, None, None] & there, turned, rows)


def _loss(
    config: OutcomeConfig, params: Params, scenes: Scenes, batch: Examples, which: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Weighted cross entropy and accuracy. The paper's binary one on two softmax outputs is the same number."""
    rows = mirror_rows(jnp.asarray(scenes.rows)[batch.game], which)
    found = _apply(config, params, rows, batch.plans, scenes, batch.game)
    each = optax.softmax_cross_entropy_with_integer_labels(found, batch.label)
    total = jnp.maximum(batch.weight.sum(), 1e-9)
    right = (found.argmax(axis=-1) == batch.label).astype(jnp.float32)
    return (each * batch.weight).sum() / total, (right * batch.weight).sum() / total


def _epoch_indices(config: OutcomeConfig, key: jax.Array, weight: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Plays of each batch (steps, B), and which of them count: the last batch is filled up."""
    plays = len(weight)
    steps = steps_per_epoch(config, plays)
    size = steps * config.batch_size
    if config.draws:
        sums = jnp.cumsum(weight)
        drawn = jnp.searchsorted(sums, jax.random.uniform(key, (size,)) * sums[-1])
        index, counts = jnp.minimum(drawn, plays - 1), jnp.ones(size)
    else:
        index = jnp.pad(jax.random.permutation(key, plays), (0, size - plays))
        counts = (jnp.arange(size) < plays).astype(jnp.float32)
    return index.reshape(steps, -1), counts.reshape(steps, -1)


def _one_epoch(
    config: OutcomeConfig, material: Material, number: jax.Array, seed: jax.Array, state: OutcomeState
) -> tuple[OutcomeState, History]:
    """One network's next epoch."""
    train = material.train
    optimizer = _optimizer(config, len(train.label))
    key = jax.random.fold_in(jax.random.key(seed), number + 1)
    order_key, mirror_key = jax.random.split(key)
    index, counts = _epoch_indices(config, order_key, jnp.asarray(train.weight))
    which = jax.random.bernoulli(mirror_key, 0.5, index.shape) & config.mirrored

    def step(carry: tuple[Params, Any], batch: tuple[jax.Array, ...]) -> tuple[tuple[Params, Any], jax.Array]:
        params, moments = carry
        chosen, counted, turned = batch
        plays = jax.tree.map(lambda leaf: jnp.asarray(leaf)[chosen], train)
        plays = plays._replace(weight=counted if config.draws else plays.weight * counted)
        (loss, _), gradient = jax.value_and_grad(partial(_loss, config), has_aux=True)(
            params, material.scenes, plays, turned
        )
        updates, moments = optimizer.update(gradient, moments, params)
        return (optax.apply_updates(params, updates), moments), loss

    (params, moments), losses = jax.lax.scan(step, (state.params, state.moments), (index, counts, which))
    held, unturned = material.held, jnp.zeros(len(material.held.label), bool)
    held_loss, held_accuracy = _loss(config, params, material.held_scenes, held, unturned)
    better = held_loss < state.best_loss
    best = jax.tree.map(lambda new, old: jnp.where(better, new, old), params, state.best)
    made = (number + 1).astype(jnp.int32)
    kept = (jnp.minimum(held_loss, state.best_loss), jnp.where(better, made, state.best_epoch))
    return OutcomeState(params, moments, best, *kept), History(losses.mean(), held_loss, held_accuracy)


@partial(jax.jit, static_argnums=0)
def train_chunk(
    config: OutcomeConfig, material: Material, first: jax.Array, state: OutcomeState
) -> tuple[OutcomeState, History]:
    """Make the next `config.chunk` epochs, of which `first` were made, with all seeds."""
    seeds = jnp.arange(config.seeds, dtype=jnp.uint32)

    def epoch(state: OutcomeState, number: jax.Array) -> tuple[OutcomeState, History]:
        return jax.vmap(partial(_one_epoch, config, material, number))(seeds, state)

    return jax.lax.scan(epoch, state, first + jnp.arange(config.chunk))


@partial(jax.jit, static_argnums=0)
def _judge(config: OutcomeConfig, params: Params, scenes: Scenes, game: jax.Array, plans: Plans) -> jax.Array:
    """Chance of success, (K, B), by networks of K seeds."""
    found = jax.vmap(lambda one: logits(config, one, scenes, game, plans))(params)
    return jax.nn.softmax(found, axis=-1)[..., 1]


def predict(
    config: OutcomeConfig, params: Params, scenes: Scenes, game: npt.NDArray[np.int32], plans: Plans
) -> npt.NDArray[np.float64]:
    """The chance of success that networks of K seeds give N plans, (K, N)."""
    blocks = []
    for first in range(0, len(game), BLOCK):
        # The last block is filled up with the first plan: one program for all.
        index = np.arange(first, first + BLOCK)
        index = np.where(index < len(game), index, 0)
        block = Plans(*(np.asarray(part)[index] for part in plans))
        found = np.asarray(_judge(config, params, scenes, game[index], block), np.float64)
        blocks.append(found[:, : len(game) - first])
    count = jax.tree.leaves(params)[0].shape[0]
    return np.concatenate(blocks, axis=1) if blocks else np.zeros((count, 0))


def chosen(config: OutcomeConfig, state: OutcomeState) -> Params:
    """The parameters that are kept."""
    return state.best if config.keep_best else state.params


def parameter_count(params: Params) -> int:
    """Numbers of one network of several seeds."""
    return sum(leaf[0].size for leaf in jax.tree.leaves(params))

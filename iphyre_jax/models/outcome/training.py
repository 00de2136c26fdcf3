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

from iphyre_jax.models.outcome.batches import epoch_batches, steps_per_epoch
from iphyre_jax.models.outcome.networks.fusion import network
from iphyre_jax.models.outcome.plays.inputs import Examples, Plans, Scenes
from iphyre_jax.models.outcome.settings import OutcomeConfig

BLOCK: Final = 2048  # plans judged at once
GROUP: Final = 128  # plans of one scene judged at once, or a multiple of these
SCENES: Final = 20  # judged at once, each with its group of plans
LEAST: Final = -1e9  # a score that never counts; an infinite one has no gradient

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


def start(config: OutcomeConfig, material: Material, params: Params | None = None) -> OutcomeState:
    """The state before the first epoch, with new parameters or those of trained networks of as many seeds."""
    first = jax.tree.map(lambda leaf: jnp.asarray(leaf[:1]), material.train)

    def one(seed: jax.Array) -> OutcomeState:
        rows = jnp.asarray(material.scenes.rows)[first.game]
        params = network(config).init(jax.random.key(seed), rows, first.plans, material.scenes, first.game)
        moments = _optimizer(config, len(material.train.label)).init(params)
        return OutcomeState(params, moments, params, jnp.float32(math.inf), jnp.int32(0))

    state: OutcomeState = jax.jit(jax.vmap(one))(jnp.arange(config.seeds, dtype=jnp.uint32))
    if params is None:
        return state
    given = jax.tree.map(jnp.array, params)
    return state._replace(params=given, best=given)


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
    """Weighted cross entropy and accuracy. The paper's binary one on two softmax outputs is the same number.

    Plays come one by one, or as (B, P): P of a scene, which is then encoded once, and may be learned as a list too.
    """
    game = batch.game if batch.game.ndim == 1 else batch.game[:, 0]
    rows = mirror_rows(jnp.asarray(scenes.rows)[game], which)
    found = _apply(config, params, rows, batch.plans, scenes, game)
    each = optax.softmax_cross_entropy_with_integer_labels(found, batch.label)
    total = jnp.maximum(batch.weight.sum(), 1e-9)
    right = (found.argmax(axis=-1) == batch.label).astype(jnp.float32)
    loss = (each * batch.weight).sum() / total
    if config.listwise and batch.label.ndim == 2:
        loss += config.listwise * _listwise_loss(found[..., 1] - found[..., 0], batch.label == 1)
    return loss, (right * batch.weight).sum() / total


def _listwise_loss(score: jax.Array, solves: jax.Array) -> jax.Array:
    """Minus the log of the chance that a scene's best plan solves it, if plans (B, P) are drawn by exp(score).

    The mean over scenes of which some plans solve and some fail. Source: the top-one probability of ListNet (Cao et al.
    2007).
    """
    solved = jax.nn.logsumexp(jnp.where(solves, score, LEAST), axis=1)
    both = solves.any(axis=1) & ~solves.all(axis=1)
    each = jnp.where(both, jax.nn.logsumexp(score, axis=1) - solved, 0.0)
    return each.sum() / jnp.maximum(both.sum(), 1)


def _one_epoch(
    config: OutcomeConfig, material: Material, number: jax.Array, seed: jax.Array, state: OutcomeState
) -> tuple[OutcomeState, History]:
    """One network's next epoch."""
    train = material.train
    optimizer = _optimizer(config, len(train.label))
    key = jax.random.fold_in(jax.random.key(seed), number + 1)
    order_key, mirror_key = jax.random.split(key)
    index, counts = epoch_batches(config, order_key, train, len(material.scenes.rows))
    which = jax.random.bernoulli(mirror_key, 0.5, index.shape[:2]) & config.mirrored

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


def predict_for(config: OutcomeConfig, params: Params, scenes: Scenes, plans: Plans) -> npt.NDArray[np.float64]:
    """The chance of success that networks of K seeds give N plans of the one scene in `scenes`, (K, N)."""
    count = len(plans.seconds)
    if config.network != "ranker":
        return predict(config, params, scenes, np.zeros(count, np.int32), plans)
    # Filled up with the first plan, so that few numbers of plans need a program; the scene is encoded once.
    index = np.arange(-(-count // GROUP) * GROUP)
    index = np.where(index < count, index, 0)
    group = Plans(*(np.asarray(part)[None, index] for part in plans))
    return predict_groups(config, params, scenes, group)[:, 0, :count]


def predict_groups(config: OutcomeConfig, params: Params, scenes: Scenes, plans: Plans) -> npt.NDArray[np.float64]:
    """The chance of success that rankers of K seeds give P plans (S, P, 12) of each of S scenes, (K, S, P)."""
    found = []
    for first in range(0, len(scenes.rows), SCENES):
        part = slice(first, first + SCENES)
        some, of_these = jax.tree.map(partial(_rows, part), (scenes, plans))
        game = np.arange(len(some.rows), dtype=np.int32)
        found.append(np.asarray(_judge(config, params, some, game, of_these), np.float64))
    return np.concatenate(found, axis=1)


def _rows(part: slice, leaf: npt.ArrayLike) -> jax.Array:
    return jnp.asarray(leaf)[part]


def chosen(config: OutcomeConfig, state: OutcomeState) -> Params:
    """The parameters that are kept."""
    return state.best if config.keep_best else state.params

"""Training of `objects`: compiled chunks of steps, each on windows of plays, all drawn from seed and step."""

from __future__ import annotations

from functools import partial
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optax

from iphyre_jax.envs.arguments import key_of
from iphyre_jax.models.world.networks import mdrnn, objects
from iphyre_jax.models.world.networks.objects import Sigma
from iphyre_jax.models.world.plays import windows
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import Plays, SceneTables, State, state_of

UNITS: Final = (1.0, 5.0, 0.02, 0.2)  # px, px/s, rad, rad/s: errors that count alike
SPREAD: Final = 0.1  # weight of the pinball loss, from which only sigma learns
WITHIN: Final = 0.6827  # share of errors within one sigma
CLIP: Final = 1.0  # of the gradient's norm

Params = Any


class TrainState(NamedTuple):
    """What training changes."""

    params: Params
    moments: Any  # of the optimiser


def optimizer(config: WorldConfig) -> optax.GradientTransformation:
    """Adam with a rate that falls to zero."""
    rate = optax.cosine_decay_schedule(config.learning_rate, config.steps)
    return optax.chain(optax.clip_by_global_norm(CLIP), optax.adam(rate))


def start(config: WorldConfig) -> TrainState:
    """The state before the first step."""
    network = objects if config.model == "objects" else mdrnn
    params = network.init(config, key_of(config.seed))
    return TrainState(params, optimizer(config).init(params))


def window_length(config: WorldConfig, step: int) -> int:
    """Steps of 0.1 s of the windows that are learned from after so many gradient steps."""
    if config.model == "mdrnn":
        return config.sequence
    return 1 if 2 * step < config.steps else config.unroll


def taken(tables: SceneTables, scene: jax.Array) -> SceneTables:
    """The tables of each of B worlds, by indices (B,)."""
    return jax.tree.map(lambda table: jnp.asarray(table)[scene], tables)


def _errors(mean: State, target: State) -> Sigma:
    """Errors of the mean, (B, M, 2) for places and velocities, (B, M, 1) for the others."""
    return Sigma(
        mean.centre - target.centre,
        mean.velocity - target.velocity,
        (mean.angle - target.angle)[..., None],
        (mean.spin - target.spin)[..., None],
    )


def step_loss(mean: State, sigma: Sigma, target: State, moves: jax.Array, certain: jax.Array) -> jax.Array:
    """Pseudo-Huber error of the mean, and the pinball loss by which sigma alone learns how large 68 % of errors are.

    Errors have heavy tails: nearly all are small, and a contact that was missed is large. The likelihood of a Gaussian
    is ruled by the few, and had 98 % of errors within one sigma.

    Args:
        mean: predicted, of B worlds.
        sigma: predicted.
        target: what came.
        moves: (B, M) bool, there is such a body.
        certain: (B, 1) bool, the step began where the world really was.
    """
    total = jnp.zeros(moves.shape)
    for error, spread, unit, (low, _) in zip(_errors(mean, target), sigma, UNITS, objects.BOUNDS, strict=True):
        total += (jnp.sqrt(1 + jnp.square(error / unit)) - 1).mean(axis=-1)
        size = jnp.maximum(jnp.abs(jax.lax.stop_gradient(error)), low)
        beyond = jnp.log(size) - jnp.log(spread)[..., None]
        total += SPREAD * certain * (beyond * (WITHIN - (beyond < 0))).mean(axis=-1)
    return (total * moves).sum() / jnp.maximum(moves.sum(), 1)


def noisy(config: WorldConfig, key: jax.Array, state: State) -> tuple[State, jax.Array]:
    """Half of the worlds with noise of a random size, at most that of the settings; and which have none, (B, 1)."""
    keys = jax.random.split(key, 3)
    size = jnp.maximum(jax.random.uniform(keys[0], (state.angle.shape[0], 1, 1), minval=-1.0), 0.0)
    moved = state._replace(
        centre=state.centre + size * config.noise_px * jax.random.normal(keys[1], state.centre.shape),
        velocity=state.velocity + size * config.noise_speed * jax.random.normal(keys[2], state.velocity.shape),
    )
    return moved, size[:, 0] == 0


def loss(config: WorldConfig, params: Params, plays: Plays, index: jax.Array, key: jax.Array, steps: int) -> jax.Array:
    """Mean loss of windows (B, 2), play and instant, rolled out over so many steps."""
    number, instant = index[:, 0], index[:, 1]
    if config.model == "mdrnn":
        return mdrnn.loss(params, plays, number, instant, steps)
    scene = taken(plays.scenes, jnp.asarray(plays.scene)[number])
    gone, recorded = jnp.asarray(plays.gone)[number], jnp.asarray(plays.state)
    begin, clean = noisy(config, key, state_of(recorded[number, instant]))

    def advance(state: State, k: jax.Array) -> tuple[State, jax.Array]:
        alive = gone > (instant + k)[:, None]
        mean, sigma = objects.step(config, params, scene, state, alive, config.neighbours)
        target = state_of(recorded[number, instant + k + 1])
        return mean, step_loss(mean, sigma, target, jnp.asarray(scene.moves), clean & (k == 0))

    _, losses = jax.lax.scan(advance, begin, jnp.arange(steps))
    return losses.mean()


@partial(jax.jit, static_argnums=(0, 5))
def _steps(
    config: WorldConfig,
    state: TrainState,
    plays: Plays,
    index: jax.Array,
    first: jax.Array,
    length: int,
    key: jax.Array,
) -> tuple[TrainState, jax.Array]:
    """Steps on windows (K, B, 2); their losses (K,). The key of the seed is an argument: all seeds share a program."""
    update_of = optimizer(config).update

    def step(carry: TrainState, batch: tuple[jax.Array, jax.Array]) -> tuple[TrainState, jax.Array]:
        rows, number = batch
        own = jax.random.fold_in(key, number)
        value, gradient = jax.value_and_grad(lambda params: loss(config, params, plays, rows, own, length))(
            carry.params
        )
        updates, moments = update_of(gradient, carry.moments, carry.params)
        return TrainState(optax.apply_updates(carry.params, updates), moments), value

    return jax.lax.scan(step, state, (index, first + jnp.arange(len(index))))


def drawn_windows(config: WorldConfig, plays: Plays, first: int, length: int) -> npt.NDArray[np.int32]:
    """Windows of the next chunk of steps, (chunk, B, 2)."""
    found, weight = windows(plays, length)
    if not len(found):
        raise ValueError(f"plays: expected some of more than {length} steps of 0.1 s, got none")
    rng = np.random.default_rng([config.seed, first, length])
    chosen = rng.choice(len(found), (config.chunk, config.batch_size), p=weight / weight.sum())
    return found[chosen]


def train_chunk(config: WorldConfig, state: TrainState, plays: Plays, first: int) -> tuple[TrainState, float]:
    """Make the next `config.chunk` steps, of which `first` were made; the mean loss too."""
    length = window_length(config, first)
    index = jnp.asarray(drawn_windows(config, plays, first, length))
    state, losses = _steps(config, state, plays, index, jnp.int32(first), length, key_of(config.seed))
    return state, float(losses.mean())

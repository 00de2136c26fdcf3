"""One interface of all world models: predict(params, memory, rows, removal) -> (rows, memory)."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks import mdrnn, objects
from iphyre_jax.models.world.networks.geometry import contact
from iphyre_jax.models.world.rows import ROW, centres, rows_of, state_in
from iphyre_jax.models.world.settings import WorldConfig
from iphyre_jax.models.world.tables import SceneTables, State, state_of
from iphyre_jax.observations.official import LENGTH_COLUMNS
from iphyre_jax.physics.constants import GRAVITY
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES

Params = Any
SECONDS: Final = 1 / DECISIONS_PER_SECOND  # s, that a prediction looks ahead
FALL: Final = 5 / 12  # px that gravity adds in 0.1 s: 15 of (1/60 s)^2 x 100 px/s^2
NEIGHBOURS: Final = 6  # objects that a body may touch


class Memory(NamedTuple):
    """What a model keeps of B worlds: their scenes, and what it remembers."""

    scene: SceneTables  # (B, ...)
    recurrent: Any  # of "mdrnn": two (B, 256); of a bound: the tables 0.1 s before, zeros at the start; else ()


Predict = Callable[[Params, Memory, jax.Array, jax.Array], tuple[jax.Array, Memory]]
"""Parameters, memory, tables (B, 12, 12) as `rows_of` gives them and blocks (B, 12) that are removed now -> the tables
0.1 s later, and the memory."""


def start_memory(config: WorldConfig | None, scene: SceneTables) -> Memory:
    """The memory before the first step, of a bound if there are no settings; scene: tables of each of B worlds."""
    if config is None:
        return Memory(scene, jnp.zeros((*scene.radius.shape, ROW)))
    return Memory(scene, mdrnn.empty_memory(scene.centre.shape[0]) if config.model == "mdrnn" else ())


@partial(jax.jit, static_argnums=(0, 6))
def memory_after(
    predict: Predict,
    params: Params,
    memory: Memory,
    recorded: jax.Array,
    gone: jax.Array,
    instant: jax.Array,
    steps: int,
) -> Memory:
    """The memory of a model that saw some of B plays just before an instant of each, which it is to see next.

    Args:
        predict: of a model.
        params: its parameters.
        memory: as `start_memory` gives it.
        recorded: (B, T, M, 6) states of the plays, as in `Plays`.
        gone: (B, 12) instants from which on objects are gone.
        instant: (B,) below T.
        steps: how many instants it saw, static; fewer where the play had fewer.
    """
    if not jax.tree.leaves(memory.recurrent):
        return memory

    def see(before: Memory, ago: jax.Array) -> tuple[Memory, None]:
        k = (instant - ago)[:, None]
        state = jnp.take_along_axis(recorded, jnp.maximum(k, 0)[..., None, None], axis=1)[:, 0]
        rows = rows_of(before.scene, state_of(state), gone >= k)  # before the removals that are due
        _, after = predict(params, before, rows, gone == k)

        def kept(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(jnp.expand_dims(instant >= ago, range(1, new.ndim)), new, old)

        return before._replace(recurrent=jax.tree.map(kept, after.recurrent, before.recurrent)), None

    return jax.lax.scan(see, memory, jnp.arange(steps, 0, -1))[0]


def start_rows(scene: SceneTables) -> jax.Array:
    """The tables of B worlds one physics step after their start: what moves has begun to fall."""
    own = jnp.take_along_axis(jnp.asarray(scene.centre), scene.mover[..., None], axis=1)
    none = jnp.zeros(own.shape[:2])
    velocity = jnp.stack([none, none + GRAVITY * objects.TICK], axis=-1)
    return rows_of(scene, State(own, none, velocity, none), scene.radius > 0)


@lru_cache(64)  # one function for each setting, hence one program
def predictor(config: WorldConfig, neighbours: int = NEIGHBOURS) -> Predict:
    """The prediction of a trained model: of "objects" and of "mdrnn" the mean."""
    return partial(_mdrnn if config.model == "mdrnn" else _objects, config, neighbours)


def _objects(
    config: WorldConfig, neighbours: int, params: Params, memory: Memory, rows: jax.Array, removal: jax.Array
) -> tuple[jax.Array, Memory]:
    scene, state = state_in(memory.scene, rows)
    alive = (rows[..., LENGTH_COLUMNS - 1] > 0) & ~removal
    after, _ = objects.step(config, params, scene, state, alive, neighbours)
    return rows_of(scene, after, alive), memory


def _mdrnn(
    config: WorldConfig, neighbours: int, params: Params, memory: Memory, rows: jax.Array, removal: jax.Array
) -> tuple[jax.Array, Memory]:
    del config, neighbours
    found, recurrent = mdrnn.next_rows(params, memory.recurrent, rows, removal, memory.scene)
    return found, memory._replace(recurrent=recurrent)


def nothing_moves(params: Params, memory: Memory, rows: jax.Array, removal: jax.Array) -> tuple[jax.Array, Memory]:
    """A bound: all stays where it is."""
    del params
    return jnp.where(removal[..., None], 0.0, rows), memory


def moves_on(params: Params, memory: Memory, rows: jax.Array, removal: jax.Array) -> tuple[jax.Array, Memory]:
    """A bound that sees places alone: in each 0.1 s bodies go as far as in the one before, without turning."""
    del params
    scene, state = state_in(memory.scene, rows)
    alive = rows[..., LENGTH_COLUMNS - 1] > 0
    before = jnp.take_along_axis(memory.recurrent, scene.mover[..., None], axis=1)
    known = before[..., LENGTH_COLUMNS - 1 : LENGTH_COLUMNS] > 0
    further = jnp.where(known, 2 * state.centre - centres(before), state.centre)
    after = rows_of(scene, state._replace(centre=further), alive & ~removal)
    return after, memory._replace(recurrent=rows)


def falls_until_contact(
    params: Params, memory: Memory, rows: jax.Array, removal: jax.Array
) -> tuple[jax.Array, Memory]:
    """A bound: bodies fall freely, and stop for good where they meet another object."""
    del params
    scene, state = state_in(memory.scene, rows)
    alive = (rows[..., LENGTH_COLUMNS - 1] > 0) & ~removal
    down = jnp.array([[[0.0, 1.0]]])
    fallen = state.centre + state.velocity * SECONDS + FALL * down
    centre, half = centres(rows), scene.half
    own_half = jnp.take_along_axis(jnp.asarray(half), scene.mover[..., None], axis=1)
    own_radius = jnp.take_along_axis(jnp.asarray(scene.radius), scene.mover, axis=1)
    touch = contact(
        fallen[:, :, None],
        own_half[:, :, None],
        own_radius[:, :, None],
        centre[:, None],
        half[:, None],
        scene.radius[:, None],
    )
    other = alive[:, None] & ~(jax.nn.one_hot(scene.mover, alive.shape[1]) > 0)
    meets = ((touch.gap < 0) & other).any(axis=-1)[..., None]
    speed = jnp.where(meets, 0.0, state.velocity + GRAVITY * SECONDS * down)
    return rows_of(scene, State(jnp.where(meets, state.centre, fallen), state.angle, speed, state.spin), alive), memory


@partial(jax.jit, static_argnums=(0, 5, 6))
def roll(
    predict: Predict,
    params: Params,
    memory: Memory,
    rows: jax.Array,
    gone: jax.Array,
    steps: int = FRAMES,
    kept: Callable[[jax.Array], jax.Array] = centres,
) -> jax.Array:
    """What is kept of tables, (steps, B, ...), after 0.1, 0.2, ... s; by default centres. Removed objects are 0.

    Args:
        predict: of a model.
        params: its parameters.
        memory: of B worlds.
        rows: their tables now.
        gone: (B, 12) in how many steps each object is removed: 0 for now, below 0 or large for never.
        steps: to predict.
        kept: gives what is kept of tables (B, 12, 12); static.
    """

    def advance(carry: tuple[jax.Array, Memory], k: jax.Array) -> tuple[tuple[jax.Array, Memory], jax.Array]:
        table, remembered = predict(params, carry[1], carry[0], gone == k)
        return (table, remembered), kept(table)

    return jax.lax.scan(advance, (rows, memory), jnp.arange(steps))[1]

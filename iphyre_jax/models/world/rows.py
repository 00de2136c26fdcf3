"""The official table with motion, in px, from the state of a world, and back; on a device."""

from __future__ import annotations

from typing import Final

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks.geometry import rotated
from iphyre_jax.models.world.tables import Array, SceneTables, State
from iphyre_jax.observations.official import COLUMNS

ROW: Final = COLUMNS + 3  # the official columns, vx, vy (px/s) and spin (rad/s)


def all_objects(scene: SceneTables, state: State) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Centre, half axis and velocity (B, 12, 2) and spin (B, 12) of all objects of B worlds."""
    owner = jax.nn.one_hot(scene.mover, scene.centre.shape[1]) * scene.moves[..., None]
    still = 1.0 - owner.sum(axis=1)
    half = rotated(jnp.take_along_axis(jnp.asarray(scene.half), scene.mover[..., None], axis=1), state.angle)

    def spread(moving: jax.Array, start: jax.Array) -> jax.Array:
        return jnp.einsum("bmo,bmc->boc", owner, moving) + still[..., None] * start

    none = jnp.zeros_like(scene.centre)
    return (
        spread(state.centre, scene.centre),
        spread(half, scene.half),
        spread(state.velocity, none),
        jnp.einsum("bmo,bm->bo", owner, state.spin),
    )


def centres(rows: Array) -> Array:
    """Centres (..., 2), px, of the objects in tables (..., 12) or more columns, of JAX or NumPy."""
    return (rows[..., 0:2] + rows[..., 2:4]) / 2


def rows_of(scene: SceneTables, state: State, alive: jax.Array) -> jax.Array:
    """Tables (B, 12, 12) in px: x1, y1, x2, y2, radius, eliminable, dynamic, joint, spring, vx, vy, spin.

    Joint and spring are flags, as agents see them. Rows of removed objects are zero.

    Args:
        scene: tables of each world, (B, ...).
        state: of their moving bodies.
        alive: (B, 12) bool.
    """
    centre, half, velocity, spin = all_objects(scene, state)
    present = alive & (scene.radius > 0)
    moving = (jax.nn.one_hot(scene.mover, centre.shape[1]) * scene.moves[..., None]).sum(axis=1)
    ties = (scene.links & present[:, None, :, None] & present[:, None, None, :]).any(axis=-1)
    columns = [
        *(centre - half).transpose(2, 0, 1),
        *(centre + half).transpose(2, 0, 1),
        scene.radius,
        scene.eliminable,
        moving,
        ties[:, 0],
        ties[:, 1],
        *velocity.transpose(2, 0, 1),
        spin,
    ]
    table = jnp.stack([jnp.asarray(column, jnp.float32) for column in columns], axis=-1)
    return jnp.where(present[..., None], table, 0.0)


def state_in(scene: SceneTables, rows: jax.Array) -> tuple[SceneTables, State]:
    """The scene with the half axes that the rows show, and the state, whose angles count from there."""
    half = (rows[..., 2:4] - rows[..., 0:2]) / 2
    own = jnp.take_along_axis(rows, scene.mover[..., None], axis=1)
    centre = centres(own)
    state = State(centre, jnp.zeros(centre.shape[:2]), own[..., COLUMNS : COLUMNS + 2], own[..., COLUMNS + 2])
    return scene._replace(half=half), state

"""Pins and springs: they act along and across the line between two centres."""

from __future__ import annotations

from typing import Any, Final

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks.geometry import dot, length, perpendicular
from iphyre_jax.models.world.networks.mlp import apply
from iphyre_jax.models.world.networks.pairs import PLACE, SPEED, limited, own_rows
from iphyre_jax.models.world.rows import all_objects
from iphyre_jax.models.world.tables import NO_TIE, PIN, SPRING, SceneTables, State
from iphyre_jax.physics.constants import GRAVITY

TIE_FEATURES: Final = 14
TIE_ANSWERS: Final = 4  # changes of speed and of place, along and across

Params = dict[str, Any]


def tie_push(params: Params, scene: SceneTables, state: State, alive: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Changes of speed and place, (B, M, 2), by pins and springs; they act along and across the line of centres."""
    centre, _, velocity, _ = all_objects(scene, state)
    apart = state.centre[:, :, None] - own_rows(centre, scene.tied)
    away = length(apart)
    along = apart / away[..., None]
    across = perpendicular(along)
    relative = state.velocity[:, :, None] - own_rows(velocity, scene.tied)
    there = (scene.tie != NO_TIE) & own_rows(alive, scene.tied)
    pin, spring = (scene.tie == PIN).astype(jnp.float32), (scene.tie == SPRING).astype(jnp.float32)
    movable = jax.nn.one_hot(scene.mover, scene.centre.shape[1]) * scene.moves[..., None]
    speed_n, speed_t = dot(relative, along), dot(relative, across)
    stretch = away - scene.rest
    turning = jnp.square(speed_t) / jnp.maximum(away, 5.0)
    features = [
        pin * limited(stretch, 1.0, 3.0),
        spring * stretch / 100,
        pin * speed_n / SPEED,
        spring * speed_n / SPEED,
        pin * speed_t / SPEED,
        spring * speed_t / SPEED,
        pin * turning / GRAVITY,
        spring * turning / GRAVITY,
        pin * along[..., 1],
        pin * across[..., 1],
        own_rows(movable.sum(axis=1), scene.tied),
        pin,
        spring,
        away / 200,
    ]
    answer = apply(params["tie"], jnp.stack(features, axis=-1)) * there[..., None]

    def vector(n: jax.Array, t: jax.Array) -> jax.Array:
        return (n[..., None] * along + t[..., None] * across).sum(axis=2)

    return vector(answer[..., 0], answer[..., 1]) * SPEED, vector(answer[..., 2], answer[..., 3]) * PLACE

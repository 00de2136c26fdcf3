"""Pairs of a moving body and an object that it may touch: what the network sees of them, and what its answers do."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.models.world.networks.geometry import Contact, contact, cross, dot, length, perpendicular, rotated
from iphyre_jax.models.world.rows import all_objects
from iphyre_jax.models.world.tables import SceneTables, State
from iphyre_jax.rules import DECISIONS_PER_SECOND

REACH: Final = 16.0  # px: what is farther away at the beginning of a part is not touched in it
EDGE: Final = 8.0  # px over which the answer fades in
SPEED, PLACE = 20.0, 1.0  # px/s and px, of outputs of size one
FEATURES: Final = 38  # of a pair
ANSWERS: Final = 6  # of a pair: changes of speed along normal, tangent and at the second contact, and of place

Params = dict[str, Any]


class Edges(NamedTuple):
    """The K objects that each moving body may touch within 0.1 s."""

    other: jax.Array  # (B, M, K) int32
    there: jax.Array  # (B, M, K) bool


def own_rows(table: jax.Array, index: jax.Array) -> jax.Array:
    """Rows of a table (B, 12, ...) by indices (B, ...).

    Numbers are picked by a product with ones and zeros, which is exact: the gradient of taking them by index adds row
    by row, which costs most of a training step on a processor.
    """
    flat = index.reshape(index.shape[0], -1)
    if jnp.issubdtype(table.dtype, jnp.floating):
        chosen = jax.nn.one_hot(flat, table.shape[1], dtype=table.dtype)
        rows = table.reshape(*table.shape[:2], -1)
        taken = jnp.einsum("bko,boc->bkc", chosen, rows, precision="highest")
    else:
        rows = table.reshape(*table.shape[:2], -1)
        taken = jnp.take_along_axis(rows, flat[..., None], axis=1)
    return taken.reshape(*index.shape, *table.shape[2:])


def near_edges(scene: SceneTables, state: State, alive: jax.Array, count: int) -> Edges:
    """The `count` objects that come nearest to each body if both keep their speed; alive: (B, 12) bool."""
    centre, half, velocity, _ = all_objects(scene, state)
    own_half = rotated(own_rows(scene.half, scene.mover), state.angle)
    found = contact(
        state.centre[:, :, None],
        own_half[:, :, None],
        own_rows(scene.radius, scene.mover)[:, :, None],
        centre[:, None],
        half[:, None],
        scene.radius[:, None],
    )
    speed = length(state.velocity[:, :, None] - velocity[:, None])
    itself = jax.nn.one_hot(scene.mover, centre.shape[1]) > 0
    there = alive[:, None] & (scene.radius[:, None] > 0) & ~itself & scene.moves[..., None]
    score = jnp.where(there, found.gap - speed / DECISIONS_PER_SECOND, 1e6)
    best, index = jax.lax.top_k(-jax.lax.stop_gradient(score), count)
    return Edges(index, (best > -1e5) & (best > -4 * REACH))


def _moment(params: Params, ball: jax.Array, radius: jax.Array) -> jax.Array:
    scale = jnp.exp(params["log_moment"])
    return jnp.where(ball, jnp.square(radius) / 2 * scale[1], 100.0 * scale[0])


class Pair(NamedTuple):
    """What is the same for both passes of a part."""

    touch: Contact
    gate: jax.Array  # (B, M, K)
    fixed: jax.Array  # (B, M, K, F) features that do not depend on speeds
    mass_n: jax.Array  # (B, M, K) effective mass along the normal
    mass_t: jax.Array
    dynamic: jax.Array  # (B, M, K)


def limited(x: jax.Array, unit: float, most: float) -> jax.Array:
    """X / unit, at most `most` in size."""
    return jnp.clip(x / unit, -most, most)


def pair_of(params: Params, scene: SceneTables, state: State, edges: Edges) -> Pair:
    """Geometry of the pairs at the beginning of a part."""
    centre, half, _, _ = all_objects(scene, state)
    own_half = rotated(own_rows(scene.half, scene.mover), state.angle)[:, :, None]
    own_radius = own_rows(scene.radius, scene.mover)[:, :, None]
    radius, half_j = own_rows(scene.radius, edges.other), own_rows(half, edges.other)
    touch = contact(state.centre[:, :, None], own_half, own_radius, own_rows(centre, edges.other), half_j, radius)
    movable = jax.nn.one_hot(scene.mover, scene.centre.shape[1]) * scene.moves[..., None]
    dynamic = own_rows(movable.sum(axis=1), edges.other)
    ball_i, ball_j = own_rows(scene.ball, scene.mover)[:, :, None], own_rows(scene.ball, edges.other)
    moment_i = _moment(params, ball_i, own_radius)
    moment_j = _moment(params, ball_j, radius)

    def mass(axis: jax.Array) -> jax.Array:
        own = 1 + jnp.square(cross(touch.arm_i, axis)) / moment_i
        return 1 / (own + dynamic * (1 + jnp.square(cross(touch.arm_j, axis)) / moment_j))

    mass_n, mass_t = mass(touch.normal), mass(touch.tangent)
    ends = [dot(sign * half_j - touch.arm_j, touch.tangent) for sign in (1, -1)]
    shape = touch.gap.shape
    flat = [jnp.broadcast_to(part, shape).astype(jnp.float32) for part in (ball_i, ball_j, own_radius / 20)]
    fixed = [
        limited(touch.gap, 1.0, 2.0),
        limited(touch.gap, 5.0, 4.0),
        limited(touch.gap, 20.0, 2.0),
        limited(touch.second_gap, 1.0, 2.0),
        limited(touch.second_gap, 10.0, 3.0),
        limited(dot(touch.second_arm - touch.arm_i, touch.tangent), 50.0, 4.0),
        touch.normal[..., 1],
        touch.tangent[..., 1],
        limited(dot(touch.arm_i, touch.normal), 20.0, 5.0),
        limited(dot(touch.arm_i, touch.tangent), 20.0, 5.0),
        dynamic * limited(dot(touch.arm_j, touch.normal), 20.0, 5.0),
        dynamic * limited(dot(touch.arm_j, touch.tangent), 20.0, 5.0),
        limited(jnp.maximum(*ends), 10.0, 3.0),
        limited(jnp.minimum(*ends), 10.0, 3.0),
        jnp.abs(dot(own_half, touch.tangent)) / 50,
        jnp.abs(dot(own_half, touch.normal)) / 50,
        mass_n,
        mass_t,
        dynamic,
        *flat,
        radius / 20,
    ]
    gate = jnp.clip((REACH - touch.gap) / EDGE, 0.0, 1.0) * edges.there
    return Pair(touch, gate, jnp.stack(fixed, axis=-1), mass_n, mass_t, dynamic)


def speed_features(pair: Pair, scene: SceneTables, state: State, edges: Edges, part: float) -> jax.Array:
    """Features (B, M, K, F) of relative speeds."""
    _, _, velocity, spin = all_objects(scene, state)
    touch = pair.touch
    other, other_spin = own_rows(velocity, edges.other), own_rows(spin, edges.other)
    own_spin = state.spin[:, :, None]
    own = state.velocity[:, :, None] + own_spin[..., None] * perpendicular(touch.arm_i)
    relative = own - other - other_spin[..., None] * perpendicular(touch.arm_j)
    along_n, along_t = dot(relative, touch.normal), dot(relative, touch.tangent)
    second = state.velocity[:, :, None] + own_spin[..., None] * perpendicular(touch.second_arm)
    second_n = dot(second - other, touch.normal)
    after = touch.gap + along_n * part
    return jnp.stack(
        [
            along_n / SPEED,
            limited(along_n, 4.0, 1.5),
            along_t / SPEED,
            limited(along_t, 4.0, 1.5),
            limited(along_t, 20.0, 1.5),
            limited(after, 1.0, 2.0),
            limited(after, 5.0, 3.0),
            jax.nn.relu(-after),
            jax.nn.relu(-after) / part / SPEED,
            limited(second_n, 20.0, 3.0),
            dot(state.velocity[:, :, None], touch.normal) / (5 * SPEED),
            dot(state.velocity[:, :, None], touch.tangent) / (5 * SPEED),
            limited(own_spin * jnp.ones_like(along_n), 2.0, 4.0),
            pair.dynamic * limited(other_spin, 2.0, 4.0),
            limited(pair.mass_n * along_n, 4.0, 3.0),
        ],
        axis=-1,
    )


class Push(NamedTuple):
    """Sums over the pairs of a body: changes of its speed, spin, place and angle."""

    velocity: jax.Array
    spin: jax.Array
    centre: jax.Array
    angle: jax.Array


def pushed(params: Params, scene: SceneTables, pair: Pair, answer: jax.Array) -> Push:
    """Turn answers (B, M, K, 6) into changes: impulses along normal and tangent, at the arms of the contacts."""
    ball = own_rows(scene.ball, scene.mover)
    moment = _moment(params, ball, own_rows(scene.radius, scene.mover))
    touch = pair.touch
    lever = cross(touch.second_arm, touch.normal)
    also = jnp.clip((REACH - touch.second_gap) / EDGE, 0.0, 1.0) / (1 + jnp.square(lever) / moment[:, :, None])

    def impulse(parts: jax.Array, unit: float) -> tuple[jax.Array, jax.Array]:
        n, t, second = (parts[..., k] * pair.gate * unit for k in range(3))
        n, t, second = (n * pair.mass_n)[..., None], (t * pair.mass_t)[..., None], (second * also)[..., None]
        vector = n * touch.normal + t * touch.tangent
        turned = cross(touch.arm_i, vector).sum(axis=2) + (lever * second[..., 0]).sum(axis=2)
        return (vector + second * touch.normal).sum(axis=2), turned / moment

    velocity, spin = impulse(answer[..., 0:3], SPEED)
    centre, angle = impulse(answer[..., 3:6], PLACE)
    return Push(velocity, spin, centre, angle)

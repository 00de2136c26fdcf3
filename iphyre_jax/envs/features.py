"""Observations on the device: the official rows, and the same with motion and time, written as selects.

The official observation is described in `iphyre_jax.observe`, whose host functions these agree with. Here one belongs
to every decision of thousands of worlds, so nothing is gathered: the rows of a scene's start are a table from which
removed blocks are blanked, and the few moving bodies are written over their rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.mixture import Mixture
from iphyre_jax.envs.protocols import FRAMES, Protocol
from iphyre_jax.observe import LENGTH_COLUMNS, SCREEN, object_rows, scene_features
from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import FAULT_NOT_FINITE, Progress
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, Scene

NOTHING = -1  # a place without an object

ROWS_SIZE = MAX_OBJECTS * 9
MOTION_SIZE = MAX_OBJECTS * 3 + 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Features:
    """What the observations of a scene need; n moving bodies and m moving bars in the largest scene of the mixture."""

    rows: jax.Array  # (12, 9) the official table at the start, px and flags
    mover: jax.Array  # (n,) int32, object of each moving body, NOTHING if there are fewer
    ends: jax.Array  # (m, 2, 2) px, end points of the moving bars less their centres at angle 0; zero for balls
    slot_object: jax.Array  # (6,) int32, object of each slot of a plan, NOTHING if there are fewer
    joints: jax.Array  # (J, 12) bool, the two objects of each joint
    springs: jax.Array  # (P, 12) bool, of each spring
    candidates: jax.Array  # (6, 2) float32, centres of the eliminable blocks / 600, then zeros


def scene_tables(scene: Scene, mixture: Mixture, dtype: str) -> Features:
    """Return the features of a scene of a mixture (host, NumPy)."""
    host = scene_features(scene)
    rows = object_rows(host, host.position, np.zeros(MAX_OBJECTS), host.present)
    movers = np.flatnonzero(scene.dynamic)
    bars = max(topology.bars for topology in mixture.topologies)
    ends = np.zeros((bars, 2, 2))
    ends[: min(bars, len(movers))] = host.ends[movers[:bars]]
    features: dict[str, Any] = {
        "rows": rows.astype(dtype),
        "mover": _padded(movers, max(topology.moving for topology in mixture.topologies)),
        "ends": ends.astype(dtype),
        "slot_object": _padded(np.array(scene.eliminable_blocks, np.int64), MAX_ELIMINABLE),
        "joints": _padded_pairs(host.joints, max(len(topology.pins) for topology in mixture.topologies)),
        "springs": _padded_pairs(host.springs, max(len(topology.springs) for topology in mixture.topologies)),
        "candidates": host.candidates,
    }
    return Features(**features)


def _padded(indices: np.ndarray[Any, Any], places: int) -> np.ndarray[Any, Any]:
    padded = np.full(places, NOTHING, np.int32)
    padded[: len(indices)] = indices
    return padded


def _padded_pairs(pairs: np.ndarray[Any, Any], places: int) -> np.ndarray[Any, Any]:
    padded = np.zeros((places, MAX_OBJECTS), bool)
    padded[: len(pairs)] = pairs
    return padded


def standing(world: World, progress: Progress) -> jax.Array:
    """Return which slots of a plan stand for a block that is still there, (6,) bool."""
    here = [jnp.any((world.column == slot) & progress.state.alive) for slot in range(MAX_ELIMINABLE)]
    return jnp.stack(here)


def object_table(features: Features, world: World, progress: Progress) -> tuple[jax.Array, jax.Array]:
    """Return the official table (12, 9) of the physics' dtype, in px, of a world as it is; and which objects are there.

    A pair's number counts the pairs that are left, as the official class renumbers them.
    """
    index = jnp.arange(MAX_OBJECTS, dtype=jnp.int32)
    gone = (features.slot_object[:, None] == index[None, :]) & ~standing(world, progress)[:, None]
    there = (features.rows[:, 4] > 0) & ~jnp.any(gone, axis=0)
    rows = features.rows
    if features.joints.shape[0]:
        rows = rows.at[:, 7].set(_pair_number(features.joints, there).astype(rows.dtype))
    if features.springs.shape[0]:
        rows = rows.at[:, 8].set(_pair_number(features.springs, there).astype(rows.dtype))
    placed = _placed(features, progress)
    for body in range(features.mover.shape[0]):
        here = (index == features.mover[body])[:, None]
        rows = jnp.concatenate([jnp.where(here, placed[body][None, :], rows[:, :4]), rows[:, 4:]], axis=1)
    return jnp.where(there[:, None], rows, jnp.zeros((), rows.dtype)), there


def _placed(features: Features, progress: Progress) -> list[jax.Array]:
    """Return x1, y1, x2, y2 of each moving body, (4,) px."""
    position, angle = progress.state.position, progress.state.angle
    placed = []
    for body in range(features.mover.shape[0]):
        x, y = position.x[body], position.y[body]
        if body < features.ends.shape[0]:
            cos, sin = jnp.cos(angle[body]), jnp.sin(angle[body])
            turned = [(end[0] * cos - end[1] * sin, end[0] * sin + end[1] * cos) for end in features.ends[body]]
            placed.append(jnp.stack([part for dx, dy in turned for part in (x + dx, y + dy)]))
        else:
            placed.append(jnp.stack([x, y, x, y]))
    return placed


def _pair_number(member: jax.Array, there: jax.Array) -> jax.Array:
    """Return the 1-based number, among those left, of the last pair each object belongs to, (12,) int32; 0 for none."""
    left = jnp.zeros((), jnp.int32)
    number = jnp.zeros(MAX_OBJECTS, jnp.int32)
    for pair in member:
        remains = jnp.any(pair) & ~jnp.any(pair & ~there)
        left = left + remains.astype(jnp.int32)
        number = jnp.where(pair & remains, left, number)
    return number


def official_rows(features: Features, world: World, progress: Progress) -> jax.Array:
    """Return the twelve official rows, (108,) float32 in [0, 1]; zeros for a world that is no longer finite."""
    rows = object_table(features, world, progress)[0].astype(jnp.float32)
    # Out of the compiler's sight, or it multiplies by 1 / 600 in place of the division, which rounds otherwise.
    screen = jax.lax.optimization_barrier(jnp.full((), SCREEN, jnp.float32))
    seen = jnp.concatenate([rows[:, :LENGTH_COLUMNS] / screen, rows[:, LENGTH_COLUMNS:]], axis=1).clip(0.0, 1.0)
    return _sound(progress, seen.reshape(-1))


def motion(features: Features, progress: Progress, protocol: Protocol) -> jax.Array:
    """Return velocities and time, (37,) float32, not clipped.

    By object row vx and vy in 600 px/s and the turning in rad/s; then the share of the 15 s gone by.
    """
    index = jnp.arange(MAX_OBJECTS, dtype=jnp.int32)
    moves = progress.state.motion
    table = jnp.zeros((MAX_OBJECTS, 3), jnp.float32)
    for body in range(features.mover.shape[0]):
        speed = jnp.stack([moves.velocity.x[body] / SCREEN, moves.velocity.y[body] / SCREEN, moves.angular[body]])
        table = jnp.where((index == features.mover[body])[:, None], speed.astype(jnp.float32)[None, :], table)
    time = progress.state.step.astype(jnp.float32) / (FRAMES * protocol.steps_per_frame)
    return _sound(progress, jnp.concatenate([table.reshape(-1), time.reshape(1)]))


def _sound(progress: Progress, seen: jax.Array) -> jax.Array:
    """Return an observation, or zeros where the world is not finite: nobody's policy should meet a NaN."""
    return jnp.where(progress.outcome.fault == FAULT_NOT_FINITE, jnp.zeros((), seen.dtype), seen)

"""Observations on a device: the official rows, and motion and time, computed with selects.

`observations.official` describes the official observation and computes the same on the host. Here thousands of worlds
need one at every decision, so nothing is gathered: the rows of a scene's start are a table, in which removed blocks
become zero and the few moving bodies are written over their rows.

Shapes are those of one world; lanes (further worlds) may stand behind every axis, as in `physics`. What the table needs
of a world (`row_inputs`) is to be computed before it, so that the table is one loop of selects over the lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.observations.official import (
    COLUMNS,
    JOINT_COLUMN,
    LENGTH_COLUMNS,
    SPRING_COLUMN,
    object_rows,
    scene_features,
)
from iphyre_jax.physics import lanes
from iphyre_jax.physics.types import Motion, Topology
from iphyre_jax.rollouts import FAULT_NOT_FINITE, EpisodeState
from iphyre_jax.rules import SCREEN
from iphyre_jax.scenes import MAX_OBJECTS, Scene

NOTHING = -1  # no object


def rows_size(objects: int) -> int:
    """Return how many numbers `official_rows` gives."""
    return objects * COLUMNS


def motion_size(objects: int) -> int:
    """Return how many numbers `motion` gives."""
    return objects * 3 + 1


ROWS_SIZE, MOTION_SIZE = rows_size(MAX_OBJECTS), motion_size(MAX_OBJECTS)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Features:
    """The unchanging part of a scene's observations, padded to n moving bodies and m moving bars.

    12 objects and 6 slots, or as many as the limits of the scenes allow.
    """

    object_rows: (
        jax.Array | None
    )  # (12, 9) the official table at the start, px and flags, for pictures; None without them
    obs_rows: jax.Array  # (12, 9) float32, the same as it is observed: lengths / 600, all clipped to [0, 1]
    mover: jax.Array  # (n,) int32, object of each moving body, NOTHING if there are fewer
    ends: jax.Array  # (m, 2, 2) px, end points of the moving bars less their centres at angle 0; zero for balls
    slot_object: jax.Array  # (6,) int32, object of each slot of a plan, NOTHING if there are fewer
    joints: jax.Array  # (J, 12) bool, the two objects of each joint
    springs: jax.Array  # (P, 12) bool, of each spring
    candidates: jax.Array  # (6, 2) float32, centres of the eliminable blocks / 600, then zeros

    @property
    def objects(self) -> int:
        """Rows of the official table."""
        return self.joints.shape[1]


def scene_tables(scene: Scene, topologies: Sequence[Topology], dtype: str) -> Features:
    """Return the features of a scene, padded to the largest of some topologies (host, NumPy)."""
    host = scene_features(scene)
    rows = object_rows(host, host.position, np.zeros(scene.limits.objects), host.present)
    scaled = rows.astype(np.float32)
    scaled[:, :LENGTH_COLUMNS] /= np.float32(SCREEN)
    movers = np.flatnonzero(scene.dynamic)
    bars = max(topology.bars for topology in topologies)
    ends = np.zeros((bars, 2, 2))
    ends[: min(bars, len(movers))] = host.ends[movers[:bars]]
    features: dict[str, Any] = {
        "object_rows": rows.astype(dtype),
        "obs_rows": scaled.clip(0.0, 1.0),
        "mover": _padded(movers.astype(np.int32), max(topology.moving for topology in topologies), NOTHING),
        "ends": ends.astype(dtype),
        "slot_object": _padded(np.array(scene.eliminable_blocks, np.int32), scene.limits.blocks, NOTHING),
        "joints": _padded(host.joints, max(len(topology.pins) for topology in topologies), False),
        "springs": _padded(host.springs, max(len(topology.springs) for topology in topologies), False),
        "candidates": host.candidates,
    }
    return Features(**features)


def _padded(rows: np.ndarray[Any, Any], size: int, fill: int | bool) -> np.ndarray[Any, Any]:
    padded = np.full((size, *rows.shape[1:]), fill, rows.dtype)
    padded[: len(rows)] = rows
    return padded


def own_features(features: Features, topology: Topology) -> Features:
    """Return features without their padding, for worlds of one topology."""
    return replace(
        features,
        mover=features.mover[: topology.moving],
        ends=features.ends[: topology.bars],
        joints=features.joints[: len(topology.pins)],
        springs=features.springs[: len(topology.springs)],
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pose:
    """The pose of a world; n moving bodies, padded to the largest scene."""

    x: jax.Array  # (n,) px
    y: jax.Array
    angle: jax.Array  # (n,) rad
    present: jax.Array  # (12,) bool, objects that are present
    sound: jax.Array  # () bool, everything is finite


def pose_of(features: Features, present_slots: jax.Array, episode: EpisodeState) -> Pose:
    """Return the pose of a world; present_slots: (slots,) bool, plan slots whose block is present."""
    state = episode.state
    sound = episode.result.fault != FAULT_NOT_FINITE
    return Pose(state.position.x, state.position.y, state.angle, present_objects(features, present_slots), sound)


def present_objects(features: Features, present_slots: jax.Array) -> jax.Array:
    """Return which of the twelve objects are present, (12,) bool; present_slots: see `pose_of`."""
    index = lanes.iota(features.obs_rows.shape[0], present_slots[0])
    present = features.obs_rows[:, LENGTH_COLUMNS - 1] > 0  # the radius
    for slot in range(present_slots.shape[0]):
        present = present & ((index != features.slot_object[slot][None]) | present_slots[slot][None])
    return present


def object_table(features: Features, pose: Pose) -> jax.Array:
    """Return the official table of a world, (12, 9) of the physics' dtype, in px; see `official.object_rows`."""
    start = cast(jax.Array, features.object_rows)
    placed = jax.lax.optimization_barrier(_body_ends(features.ends, pose))
    numbers = [_pair_number(member, pose.present).astype(start.dtype) for member in _members(features)]
    return _table(features, start, pose.present, placed, numbers)


class RowInputs(NamedTuple):
    """What the official rows need of a world; n moving bodies."""

    present: jax.Array  # (12,) bool, objects that are present; none in a world that is no longer finite
    placed: list[jax.Array]  # n of (4,) float32, see `scaled_ends`
    flags: list[jax.Array]  # of joints and springs, (12,) float32, 1 for an object that is tied


def row_inputs(features: Features, pose: Pose) -> RowInputs:
    """Return what `official_rows` needs of a world."""
    flags = [(_pair_number(member, pose.present) > 0).astype(jnp.float32) for member in _members(features)]
    return RowInputs(pose.present & pose.sound[None], scaled_ends(features.ends, pose), flags)


def official_rows(features: Features, inputs: RowInputs) -> jax.Array:
    """Return the twelve official rows, (108,) float32 in [0, 1]; zeros for a world that is no longer finite."""
    table = _table(features, features.obs_rows.astype(jnp.float32), *inputs)
    return table.reshape(-1, *table.shape[2:])


def scaled_ends(ends: jax.Array, pose: Pose) -> list[jax.Array]:
    """Return x1, y1, x2, y2 of each moving body as observed, (4,) float32 in [0, 1]; ends: of `Features`.

    What it returns for a world that is no longer finite is to be replaced.
    """
    # The compiler would multiply by the inverse of a constant, or of what is broadcast, which rounds differently. So
    # the divisor depends on the world, and each number is divided by itself; the barrier is for `backend="xla"`.
    screen = jax.lax.optimization_barrier(jnp.where(pose.sound, jnp.float32(SCREEN), jnp.float32(1)))
    return [
        jnp.stack([number.astype(jnp.float32) / screen for number in body]).clip(0.0, 1.0)
        for body in _body_ends(ends, pose)
    ]


def speeds(bodies: Motion) -> list[jax.Array]:
    """Return vx, vy (600 px/s) and angular velocity (rad/s) of each moving body, (3,) float32."""
    x, y, angular = bodies.velocity.x, bodies.velocity.y, bodies.angular_velocity
    return [
        jnp.stack([x[body] / SCREEN, y[body] / SCREEN, angular[body]]).astype(jnp.float32) for body in range(len(x))
    ]


def motion(features: Features, own_speeds: Sequence[jax.Array], step: jax.Array, steps: jax.Array) -> jax.Array:
    """Return velocities and time, (37,) float32, not clipped.

    The `speeds` of the moving bodies in their objects' rows come first, then the elapsed share of the 15 s.

    Args:
        features: of the scene.
        own_speeds: n of (3,) float32, see `speeds`.
        step: () int32, steps made.
        steps: () physics steps of a whole episode.
    """
    index = lanes.iota(features.objects, step)
    table = jnp.zeros((features.objects, 3, *step.shape), jnp.float32)
    for mover, speed in zip(features.mover, own_speeds, strict=True):
        table = jnp.where((index == mover[None])[:, None], speed[None], table)
    time = step.astype(jnp.float32) * (1 / steps.astype(jnp.float32))  # as the compiler rewrites the division
    return jnp.concatenate([table.reshape(-1, *step.shape), time[None]])


def _body_ends(ends: jax.Array, pose: Pose) -> list[jax.Array]:
    """Return x1, y1, x2, y2 of each moving body, (4,) px."""
    placed = []
    for body in range(pose.x.shape[0]):
        x, y = pose.x[body], pose.y[body]
        if body < ends.shape[0]:
            cos, sin = jnp.cos(pose.angle[body]), jnp.sin(pose.angle[body])
            turned = [(end[0] * cos - end[1] * sin, end[0] * sin + end[1] * cos) for end in ends[body]]
            placed.append(jnp.stack([part for dx, dy in turned for part in (x + dx, y + dy)]))
        else:
            placed.append(jnp.stack([x, y, x, y]))
    return placed


def _members(features: Features) -> tuple[jax.Array, jax.Array]:
    """Return the objects of the joints, then of the springs."""
    return features.joints, features.springs


def _pair_number(member: jax.Array, present: jax.Array) -> jax.Array:
    """Return the number of the last remaining pair of each object, from 1, (12,) int32, 0 for none; in lanes.

    `official.pair_number` does the same in NumPy.
    """
    left = jnp.zeros(present.shape[1:], jnp.int32)
    number = jnp.zeros(present.shape, jnp.int32)
    for pair in member:
        remains = jnp.any(pair, axis=0) & ~jnp.any(pair & ~present, axis=0)
        left = left + remains.astype(jnp.int32)
        number = jnp.where(pair & remains[None], left[None], number)
    return number


def _table(
    features: Features, start: jax.Array, present: jax.Array, placed: list[jax.Array], numbers: list[jax.Array]
) -> jax.Array:
    """Write ends, pair numbers and zeros for removed objects over the table (12, 9) of the start."""
    index = lanes.iota(start.shape[0], present[0])
    column = jnp.arange(start.shape[1], dtype=jnp.int32).reshape(1, -1, *(1,) * (present.ndim - 1))
    table = start
    for body, ends in enumerate(placed):
        whole = jax.lax.optimization_barrier(jnp.pad(ends, [(0, start.shape[1] - 4)] + [(0, 0)] * (ends.ndim - 1)))
        here = (index == features.mover[body][None])[:, None] & (column < 4)
        table = jnp.where(here, whole[None], table)
    for pair_column, member, number in zip((JOINT_COLUMN, SPRING_COLUMN), _members(features), numbers, strict=True):
        if member.shape[0]:
            table = jnp.where(column == pair_column, number[:, None], table)
    return jnp.where(present[:, None], table, jnp.zeros((), table.dtype))

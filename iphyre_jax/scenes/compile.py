"""From a validated scene to the numbers that the solver reads, all on the host in NumPy and float64."""

from __future__ import annotations

import math
from typing import Any, cast

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_dtype, check_fps, check_resets
from iphyre_jax.physics import constants as c
from iphyre_jax.physics.collision.initial_order import Insertion, point_classes, replay_insertion
from iphyre_jax.physics.types import STATIC, Timing, Topology, World
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.scene import Scene, check_is_scene

STATIC_ROOM = 10  # scenes with at most so many static bars share a program; larger ones take the next even number
SLOT_LIMIT = 16


def _array(values: npt.ArrayLike, dtype: str) -> jax.Array:
    """Return a NumPy array, rounded once from float64; `World` holds arrays of either kind."""
    return cast(jax.Array, np.asarray(values).astype(dtype))


class _Bodies:
    """Geometry of a scene's objects, and who moves."""

    def __init__(self, scene: Scene) -> None:
        blocks, balls = scene.blocks, scene.balls
        self.n_blocks = len(blocks)
        self.centre = scene.centres  # and, as in the reference, world = centre + (end - centre)
        self.end_a = blocks[:, 0] - self.centre[: self.n_blocks]
        self.end_b = blocks[:, 1] - self.centre[: self.n_blocks]
        delta = self.end_b - self.end_a
        size = np.sqrt(delta[:, 0] * delta[:, 0] + delta[:, 1] * delta[:, 1])
        self.normal = np.stack([delta[:, 1], -delta[:, 0]], -1) * (1.0 / (size + np.finfo(np.float64).tiny))[:, None]
        self.radius = balls[:, 2]
        self.moving = [bool(d) for d in scene.dynamic]
        self.movers = [i for i, m in enumerate(self.moving) if m]

    def box(self, i: int) -> tuple[float, float, float, float]:
        """Return the exact box of object i at the start, left, top, right, bottom."""
        x, y = self.centre[i].tolist()
        if i >= self.n_blocks:
            r = float(self.radius[i - self.n_blocks])
            return x - r, y - r, x + r, y + r
        (ax, ay), (bx, by) = self.end_a[i] + self.centre[i], self.end_b[i] + self.centre[i]
        r = c.BAR_RADIUS
        return min(ax, bx) - r, min(ay, by) - r, max(ax, bx) + r, max(ay, by) + r

    def insertion(self, resets: int) -> Insertion:
        """Return the broad phase before the first step."""
        return replay_insertion([self.box(i) for i in range(len(self.moving))], self.moving, resets)


def static_order(scene: Scene, resets: int = 1) -> tuple[int, ...]:
    """Return the object index of each static bar in the solver's order."""
    return _Bodies(scene).insertion(resets).static_order


def topology_of(scene: Scene) -> Topology:
    """Return the part of a scene that decides the compiled program."""
    bodies = _Bodies(scene)
    index = {obj: k for k, obj in enumerate(bodies.movers)}
    n_static = len(bodies.moving) - len(bodies.movers)
    statics = max(STATIC_ROOM, n_static + n_static % 2)
    bars, balls = sum(bodies.moving[: bodies.n_blocks]), len(bodies.radius)
    ends = [
        tuple((index.get(i, STATIC), index.get(j, STATIC)) for i, j in pairs) for pairs in (scene.joints, scene.springs)
    ]
    return Topology(bars, balls, statics, ends[0], ends[1], slots=_slots(bars, balls))


def _slots(bars: int, balls: int) -> int:
    """Return how many contact points a world may have at once: 4 a ball, 8 a bar.

    The measured need is at most two thirds of that.
    """
    return min(SLOT_LIMIT, 4 * balls + 8 * bars)


def compile_scene(scene: Scene, *, resets: int = 1, dtype: str = "float64") -> tuple[Topology, World]:
    """Return topology and numbers of a scene.

    Args:
        scene: the scene.
        resets: number of the reset of a reused space, 1 to 2**31 - 1, 1 for a fresh one. It decides solve order and
            contact ids.
        dtype: "float32" or "float64", of the floating arrays (NumPy; integers are int32).

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    check_is_scene("scene", scene)
    resets, dtype = check_resets(resets), check_dtype(dtype)
    topology, bodies = topology_of(scene), _Bodies(scene)
    insertion, n_objects = bodies.insertion(resets), len(bodies.moving)
    statics, movers, bars = list(insertion.static_order), bodies.movers, bodies.movers[: topology.bars]

    def vec(rows: np.ndarray, length: int | None = None) -> Vec:
        padded = np.zeros((len(rows) if length is None else length, 2))
        padded[: len(rows)] = rows
        return Vec(*(_array(column, dtype) for column in padded.T))

    room = topology.num_static
    columns = {obj: s for s, obj in enumerate(scene.eliminable_blocks)}
    inv_moment = [1.0 / c.BAR_MOMENT] * topology.bars + [1.0 / (c.MASS * (0.5 * r * r)) for r in bodies.radius.tolist()]
    world = World(
        start=vec(bodies.centre[movers]),
        radius=_array(bodies.radius, dtype),
        inv_moment=_array(inv_moment, dtype),
        bar_a=vec(bodies.end_a[bars]),
        bar_b=vec(bodies.end_b[bars]),
        bar_normal=vec(bodies.normal[bars]),
        static_a=vec(bodies.end_a[statics] + bodies.centre[statics], room),
        static_b=vec(bodies.end_b[statics] + bodies.centre[statics], room),
        static_normal=vec(bodies.normal[statics], room),
        static_centre=vec(bodies.centre[statics], room),
        valid=_array(np.arange(room) < len(statics), "bool"),
        plan_slot=_array([columns.get(i, -1) for i in statics] + [-1] * (room - len(statics)), "int32"),
        **_constraints(scene, bodies, statics, dtype),
        **_order(topology, insertion, movers, statics, resets, n_objects),
    )
    return topology, world


def _constraints(scene: Scene, bodies: _Bodies, statics: list[int], dtype: str) -> dict[str, Any]:
    """Return the fields of `World` that describe joints and springs."""
    anchors, anchor_statics = [], []
    for pair in (*scene.joints, *scene.springs):
        held = [i for i in pair if not bodies.moving[i]]
        anchors.append(bodies.centre[held[0]] if held else np.zeros(2))
        anchor_statics.append(statics.index(held[0]) if held else -1)
    anchor = np.array(anchors, np.float64).reshape(-1, 2)
    delta = [bodies.centre[j] - bodies.centre[i] for i, j in scene.joints]
    return {
        "anchor": Vec(*(_array(column, dtype) for column in anchor.T)),
        "anchor_static": np.array(anchor_statics, np.int32),
        "pin_length": np.array([math.sqrt(x * x + y * y) for x, y in delta], np.float64).astype(dtype),
    }


def _order(
    topology: Topology, insertion: Insertion, movers: list[int], statics: list[int], resets: int, n_objects: int
) -> dict[str, Any]:
    """Return the fields of `World` that decide the order of contacts."""
    index = {obj: k for k, obj in enumerate(movers)}
    room = topology.num_static
    static_counter = np.zeros((topology.moving, room), np.int32)
    for k, i in enumerate(movers):
        for s, j in enumerate(statics):
            static_counter[k, s] = insertion.counter.get((min(i, j), max(i, j)), 0)
    pair_counter = [insertion.counter.get((movers[i], movers[j]), 0) for i, j in topology.pairs]
    first_id = (resets - 1) * n_objects
    bars = movers[: topology.bars] + statics
    classes = np.tile(np.arange(4, dtype=np.int32)[:, None], (1, len(topology.bar_pairs)))
    for p, (i, j) in enumerate(topology.bar_pairs):
        if j < len(bars):
            classes[:, p] = point_classes(first_id + bars[i], first_id + bars[j])
    return {
        "point_class": classes,
        "leaf_order": np.array([index[i] for i in insertion.leaf_order], "int32"),
        "start_path": np.array([insertion.path[i] for i in movers], np.int32),
        "start_depth": np.array([insertion.depth[i] for i in movers], np.int32),
        "static_counter": static_counter.reshape(-1),
        "pair_counter": np.array(pair_counter, np.int32),
    }


def step_timing(fps: float, dtype: str) -> Timing:
    """Return what follows from dt = 1/fps, computed in float64 and stored in `dtype`.

    bias = 1 - base^dt; the spring's decay is 1 - exp(-damping dt k), k the sum of the ends' inverse masses.

    Args:
        fps: physics steps a second, from 0.001 to 100,000.
        dtype: "float32" or "float64".

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    dt, dtype = 1.0 / check_fps(fps), check_dtype(dtype)
    decay = [1.0 - math.exp(-c.SPRING_DAMPING * dt * k) for k in (1.0, 2.0)]
    values = (dt, 1.0 - c.BIAS_BASE**dt, c.GRAVITY * dt, decay)
    return Timing(*(_array(value, dtype) for value in values))

"""Scenes of this project as scenes of the same size in Jax2D.

Jax2D differs: bars are boxes without round ends, a joint holds two bodies at one point, and there are no springs. Each
scene gets the same number of bars, balls and joints at the same places with the same masses. A metre is 100 px, and y
points up.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from jax2d.engine import calculate_collision_matrix, create_empty_sim
from jax2d.sim_state import SimState, StaticSimParams

SCALE = 100.0  # px a metre
HEIGHT = 6.0  # m
GRAVITY = (0.0, -1.0)  # m/s^2, which is 100 px/s^2
HALF_THICKNESS = 0.1  # m
BAR_INVERSE_INERTIA = SCALE**2 / 66.67
FRICTION, RESTITUTION = 0.5, 0.1


def bars(scene: dict[str, Any]) -> list[int]:
    """1 for each moving bar, 0 for each static bar."""
    return list(scene["dynamic"][: len(scene["block"])])


def room_for(scenes: list[dict[str, Any]]) -> StaticSimParams:
    """Sizes that hold every scene; Jax2D needs at least two circles and one moving object of each other kind."""

    def most(count: Callable[[dict[str, Any]], int]) -> int:
        return max(count(scene) for scene in scenes)

    fixed = most(lambda scene: bars(scene).count(0))
    return StaticSimParams(
        num_polygons=fixed + max(1, most(lambda scene: bars(scene).count(1))),
        num_circles=max(2, most(lambda scene: len(scene["ball"]))),
        num_joints=max(1, most(lambda scene: len(scene["joint"]))),
        num_thrusters=1,
        num_static_fixated_polys=fixed,
    )


def places(scene: dict[str, Any], room: StaticSimParams) -> list[int]:
    """Jax2D's index of each object: static bars, then, after their room, moving bars, then balls."""
    fixed, moving, found = 0, room.num_static_fixated_polys, []
    for dynamic in bars(scene):
        found.append(moving if dynamic else fixed)
        fixed, moving = fixed + 1 - dynamic, moving + dynamic
    return found + [room.num_polygons + k for k in range(len(scene["ball"]))]


def point(x: float, y: float) -> list[float]:
    """A point of the picture, in metres."""
    return [x / SCALE, HEIGHT - y / SCALE]


def state_of(scene: dict[str, Any], room: StaticSimParams) -> SimState:
    """The scene at its start."""
    state = create_empty_sim(room, add_floor=False, add_walls_and_ceiling=False)
    place, dynamic = places(scene, room), bars(scene)
    shapes = {name: _fields(getattr(state, name)) for name in ("polygon", "circle")}
    centres = {}
    for k, ((x1, y1), (x2, y2)) in enumerate(scene["block"]):
        half = math.hypot(x2 - x1, y2 - y1) / 2 / SCALE + HALF_THICKNESS
        centres[place[k]] = point((x1 + x2) / 2, (y1 + y2) / 2)
        corners = [(-half, 1), (half, 1), (half, -1), (-half, -1)]
        shape = {
            "position": centres[place[k]],
            "rotation": math.atan2(y1 - y2, x2 - x1),
            "vertices": [(x, y * HALF_THICKNESS) for x, y in corners],
            "inverse_mass": dynamic[k],
            "inverse_inertia": dynamic[k] * BAR_INVERSE_INERTIA,
        }
        _write_object(shapes["polygon"], place[k], shape)
    for k, (x, y, radius) in enumerate(scene["ball"]):
        centres[room.num_polygons + k] = point(x, y)
        inertia = (radius / SCALE) ** 2 / 2
        shape = {"position": point(x, y), "radius": radius / SCALE, "inverse_mass": 1, "inverse_inertia": 1 / inertia}
        _write_object(shapes["circle"], k, shape)
    joint = _joints(scene, place, centres, _fields(state.joint))
    state = state.replace(
        polygon=state.polygon.replace(**shapes["polygon"]),
        circle=state.circle.replace(**shapes["circle"]),
        joint=state.joint.replace(**joint),
        gravity=np.array(GRAVITY, np.float32),
    )
    return state.replace(collision_matrix=calculate_collision_matrix(room, state.joint))


def _fields(part: Any) -> dict[str, np.ndarray]:  # noqa: ANN401 - a class of Jax2D
    """Writable copies of the arrays of a part of the state."""
    return {name: np.array(value) for name, value in vars(part).items()}


def _write_object(fields: dict[str, np.ndarray], index: int, values: dict[str, Any]) -> None:
    """Write an active object of the games' material."""
    for name, value in {"active": True, "friction": FRICTION, "restitution": RESTITUTION, **values}.items():
        fields[name][index] = value


def _joints(
    scene: dict[str, Any], place: list[int], centres: dict[int, list[float]], fields: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Write a joint in the middle of each joined pair."""
    for k, (i, j) in enumerate(scene["joint"]):
        a, b = np.array(centres[place[i]]), np.array(centres[place[j]])
        values = {
            "a_index": place[i],
            "b_index": place[j],
            "a_relative_pos": (b - a) / 2,
            "b_relative_pos": (a - b) / 2,
        }
        for name, value in {"active": True, **values}.items():
            fields[name][k] = value
    return fields

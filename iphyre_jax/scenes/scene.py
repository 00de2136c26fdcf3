"""The class Scene, which validates its fields."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_instance, show
from iphyre_jax.scenes.limits import MOST_OBJECTS, OFFICIAL, Limits, check_limits
from iphyre_jax.scenes.validate import Labels, check_scene

_LABELS: Final[Labels] = {
    "block": "blocks",
    "ball": "balls",
    "eli": "eliminable",
    "dynamic": "dynamic",
    "joint": "joints",
    "spring": "springs",
}


@dataclass(frozen=True, eq=False)
class Scene:
    """The start position of a game: valid and immutable.

    Objects are the bars in list order, then the balls. Lengths are in px; y points down. Arrays may be given as nested
    lists; the scene keeps read-only copies. Two scenes are equal if all their fields are equal, bit for bit.

    Attributes:
        name: the name of the game.
        blocks: (n_blocks, 2, 2) float64, the end points of the bars' axes; every bar has a radius of 10 px.
        balls: (n_balls, 3) float64, x, y and radius.
        eliminable: (n_objects,) bool, whether the player can remove the object.
        dynamic: (n_objects,) bool, whether the object moves.
        joints: pairs of object indices; a pin joint connects their centres.
        springs: pairs of object indices; a damped spring connects their centres.
        limits: how many objects the scene may have; they decide the shape of its observations and plans.

    Raises:
        ValueError: fields are wrong; one line for each.
    """

    name: str
    blocks: npt.NDArray[np.float64]
    balls: npt.NDArray[np.float64]
    eliminable: npt.NDArray[np.bool_]
    dynamic: npt.NDArray[np.bool_]
    joints: tuple[tuple[int, int], ...] = ()
    springs: tuple[tuple[int, int], ...] = ()
    limits: Limits = OFFICIAL

    def __post_init__(self) -> None:
        """Check the fields and convert them to arrays and tuples."""
        check_limits(self.limits)
        given = {key: getattr(self, label) for key, label in _LABELS.items()}
        flags = {key: _as_flags(given[key]) for key in ("eli", "dynamic")}
        raw = check_scene({"name": self.name} | given | flags, f"Scene {show(self.name)}", _LABELS, self.limits)
        converted = {
            "blocks": _frozen(raw.blocks, np.float64, (-1, 2, 2)),
            "balls": _frozen(raw.balls, np.float64, (-1, 3)),
            "eliminable": _frozen(raw.eliminable, np.bool_, (-1,)),
            "dynamic": _frozen(raw.dynamic, np.bool_, (-1,)),
            "joints": tuple(raw.joints),
            "springs": tuple(raw.springs),
        }
        for name, value in converted.items():
            object.__setattr__(self, name, value)

    @property
    def n_blocks(self) -> int:
        """The number of bars."""
        return len(self.blocks)

    @property
    def n_balls(self) -> int:
        """The number of balls."""
        return len(self.balls)

    @property
    def n_objects(self) -> int:
        """The number of bars and balls."""
        return self.n_blocks + self.n_balls

    @property
    def eliminable_blocks(self) -> tuple[int, ...]:
        """Object indices of the eliminable bars in list order: the columns of a plan."""
        return tuple(int(i) for i in np.flatnonzero(self.eliminable))

    @property
    def centres(self) -> npt.NDArray[np.float64]:
        """(n_objects, 2) px, the centre of each object at the start: of a bar (a + b) / 2, as in the reference."""
        return np.concatenate([(self.blocks[:, 0] + self.blocks[:, 1]) / 2, self.balls[:, :2]])

    @property
    def start_poses(self) -> npt.NDArray[np.float64]:
        """(n_objects, 3) px, px, rad, the pose of each object at the start: its centre, and angle 0."""
        return np.column_stack([self.centres, np.zeros(self.n_objects)])

    def _identity(self) -> tuple[object, ...]:
        arrays = (self.blocks, self.balls, self.eliminable, self.dynamic)
        return (self.name, *(array.tobytes() for array in arrays), self.joints, self.springs, self.limits)

    def __reduce__(self) -> tuple[type[Scene], tuple[object, ...]]:
        """Pickle the fields, so that a scene from another process is checked and read-only too."""
        return Scene, tuple(getattr(self, field.name) for field in fields(self))

    def __eq__(self, other: object) -> bool:
        return self._identity() == other._identity() if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._identity())


def check_is_scene(name: str, scene: object) -> Scene:
    """Return `scene`; ValueError in one line unless it is a Scene."""
    return cast(Scene, check_instance(name, scene, Scene, "a Scene, as load_scene returns it"))


def _as_flags(value: object) -> object:
    """Turn booleans into 0 and 1, as in a scene file; what is too long for any scene stays, to be refused."""
    entries = value.tolist() if isinstance(value, np.ndarray) and value.size <= 2 * MOST_OBJECTS else value
    if not isinstance(entries, (list, tuple)) or len(entries) > 2 * MOST_OBJECTS:
        return entries
    return [int(entry) if isinstance(entry, (bool, np.bool_)) else entry for entry in entries]


def _frozen(rows: object, dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[np.generic]:
    """Return a read-only array."""
    array = np.array(rows, dtype).reshape(shape)
    array.setflags(write=False)
    return array

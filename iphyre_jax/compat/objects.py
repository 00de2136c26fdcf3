"""What the official class says about the objects that are left, and its constants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import show
from iphyre_jax.compat.world import SteppedWorld
from iphyre_jax.physics.constants import BAR_RADIUS, MASS
from iphyre_jax.rules import GOAL_Y
from iphyre_jax.scenes import Scene

# Official attributes that hold objects of pymunk or pygame, or take them, and what does the same without.
_FOREIGN = {
    "space": "step, removals and get_all_property",
    "clock": "FPS",
    "draw_options": "picture",
    "get_property": "get_all_property, whose row it returns",
    "add_text": "picture",
    **{f"add_{name}": "PARAS" for name in ("all", "ball", "static_line", "dynamic_line", "joint", "spring")},
}


class Objects:
    """The lists of the official class, in the order of the objects that are left, and clicks that remove them."""

    scene: Scene
    _world: SteppedWorld | None

    # Of a ball and of a block; the solver's constants are the products of two.
    b_mass, b_elasticity, b_friction = MASS, 0.1, 0.5
    l_elasticity, l_friction = 0.1, 0.5

    @property
    def eli_mask(self) -> list[int] | None:
        """The numbers of the objects that are left; None before the first reset."""
        return None if self._world is None else self._left()

    @property
    def eli(self) -> list[int]:
        """For each object that is left, 1 if it can be removed."""
        return [int(self.scene.eliminable[k]) for k in self._left()]

    @property
    def dynamic(self) -> list[int]:
        """For each object that is left, 1 if it moves."""
        return [int(self.scene.dynamic[k]) for k in self._left()]

    @property
    def shape(self) -> list[int]:
        """For each object that is left, 1 for a block, 0 for a ball."""
        return [int(k < self.scene.n_blocks) for k in self._left()]

    @property
    def joint(self) -> list[list[int]] | None:
        """Pairs of positions in those lists that a joint ties; None in a game without joints."""
        return self._pairs(self.scene.joints)

    @property
    def spring(self) -> list[list[int]] | None:
        """Pairs of positions in those lists that a spring ties; None in a game without springs."""
        return self._pairs(self.scene.springs)

    def eliminate(self, p: Sequence[float]) -> int:
        """Click without playing; return the removed block's position in the lists until now, or -1.

        Raises:
            ValueError: p is not a position, or `reset` was not called; one line.
        """
        hit = self._hit(*position_of(p), self._started.alive)
        if hit is None:
            return -1
        index = self._left().index(hit)
        self._started.remove(hit)
        return index

    def examine_success(self) -> bool:
        """Return whether all balls are below the picture now."""
        y = self._started.poses()[0][self.scene.n_blocks : self.scene.n_objects, 1]
        return bool((y > GOAL_Y).all())

    def init_screen(self) -> None:
        """Do nothing: pictures need no window here."""

    def __getattr__(self, name: str) -> NoReturn:
        """Explain what is missing."""
        if name in _FOREIGN:
            raise AttributeError(
                f"{name}: expected pymunk and pygame, which iphyre_jax.compat does without; use {_FOREIGN[name]}"
            )
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    @property
    def _started(self) -> SteppedWorld:
        if self._world is None:
            raise ValueError(f"{self.scene.name}: expected a call of reset first")
        return self._world

    def _left(self) -> list[int]:
        alive = np.ones(self.scene.n_objects, bool) if self._world is None else self._world.alive
        return [k for k in range(self.scene.n_objects) if alive[k]]

    def _pairs(self, pairs: Sequence[tuple[int, int]]) -> list[list[int]] | None:
        place = {k: place for place, k in enumerate(self._left())}
        return [[place[i], place[j]] for i, j in pairs if i in place and j in place] if pairs else None

    def _hit(self, x: float, y: float, alive: npt.NDArray[np.bool_]) -> int | None:
        return block_at(self.scene, x, y, alive)


def block_at(scene: Scene, x: float, y: float, alive: npt.NDArray[np.bool_]) -> int | None:
    """Return the first block that a click removes: it is eliminable, and within its ends and 10 px of its axis.

    Args:
        scene: the scene.
        x: px, of the click.
        y: px.
        alive: whether each object is left.
    """
    for block in scene.eliminable_blocks:
        first, last = scene.blocks[block]
        axis = (first - last) / np.linalg.norm(first - last)
        away = np.array([x, y]) - (first + last) / 2
        along, across = away @ axis, away[0] * axis[1] - away[1] * axis[0]
        if alive[block] and abs(along) < np.linalg.norm(first - last) / 2 and abs(across) < BAR_RADIUS:
            return block
    return None


def position_of(pos: object) -> tuple[float, float]:
    """Return a click's x and y; ValueError in one line for anything else."""
    try:
        x, y = (float(part) for part in pos)  # type: ignore[attr-defined]
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"pos: expected a position x, y in px, got {show(pos)}") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"pos: expected finite numbers, got {x!r}, {y!r}")
    return x, y

"""Build scenes in Python, object by object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iphyre_jax.checks import check_flag, check_instance, is_list, show
from iphyre_jax.scenes.limits import OFFICIAL, Limits, check_limits
from iphyre_jax.scenes.parse import Ball, Point
from iphyre_jax.scenes.scene import Scene


@dataclass(frozen=True, eq=False)
class ObjectRef:
    """A block or ball of a builder; `SceneBuilder.joint` and `spring` take two of them."""

    is_ball: bool
    index: int  # among the builder's blocks, or among its balls
    builder: SceneBuilder


class SceneBuilder:
    """Collect the objects of a scene; `build` checks them and returns the scene.

        builder = SceneBuilder("two shelves")
        upper = builder.block((200, 400), (300, 400), eliminable=True)
        ball = builder.ball((250, 340), radius=20)
        builder.joint(upper, ball)
        scene = builder.build()

    Lengths are in px. x points right and y points down. The picture covers 0 to 600 in both.

    Args:
        name: the name of the scene.
        limits: how many objects it may have.

    Raises:
        ValueError: an argument of a call has a wrong type, one line; `build` refuses wrong numbers.
    """

    def __init__(self, name: str, limits: Limits = OFFICIAL) -> None:
        self.name, self.limits = name, check_limits(limits)
        self._blocks: list[tuple[Point, Point, bool, bool]] = []
        self._balls: list[Ball] = []
        self._joints: list[tuple[ObjectRef, ObjectRef]] = []
        self._springs: list[tuple[ObjectRef, ObjectRef]] = []

    def block(self, start: Point, end: Point, *, eliminable: bool = False, dynamic: bool = False) -> ObjectRef:
        """Add a block: a bar with a radius of 10 px between two points.

        Args:
            start: x, y of one end of its axis, px.
            end: x, y of the other end, px.
            eliminable: whether the player can remove it.
            dynamic: whether it moves.
        """
        check_flag("eliminable", eliminable)
        check_flag("dynamic", dynamic)
        self._blocks.append((start, end, eliminable, dynamic))
        return ObjectRef(False, len(self._blocks) - 1, self)

    def ball(self, centre: Point, radius: float = 20.0) -> ObjectRef:
        """Add a ball.

        Args:
            centre: x, y, px.
            radius: px.
        """
        if not is_list(centre) or len(centre) != 2:
            raise ValueError(f"centre: expected x, y in px, got {show(centre)}")
        x, y = centre
        self._balls.append((x, y, radius))
        return ObjectRef(True, len(self._balls) - 1, self)

    def joint(self, first: ObjectRef, second: ObjectRef) -> None:
        """Keep the centres of two objects at their initial distance."""
        self._joints.append(self._checked(first, second))

    def spring(self, first: ObjectRef, second: ObjectRef) -> None:
        """Connect the centres of two objects by a spring with a rest length of 20 px."""
        self._springs.append(self._checked(first, second))

    def build(self) -> Scene:
        """Return the scene.

        Raises:
            ValueError: the scene is not valid; one line for each wrong field.
        """
        flags = [(eliminable, dynamic) for _, _, eliminable, dynamic in self._blocks]
        flags += [(False, True)] * len(self._balls)
        return Scene(
            name=self.name,
            blocks=[[start, end] for start, end, _, _ in self._blocks],  # type: ignore[arg-type]  # lists become arrays
            balls=self._balls,  # type: ignore[arg-type]
            eliminable=np.array([eliminable for eliminable, _ in flags], bool),
            dynamic=np.array([dynamic for _, dynamic in flags], bool),
            joints=self._pairs(self._joints),
            springs=self._pairs(self._springs),
            limits=self.limits,
        )

    def _checked(self, first: ObjectRef, second: ObjectRef) -> tuple[ObjectRef, ObjectRef]:
        """Return two objects; ValueError in one line unless `block` or `ball` of this builder has returned both."""
        for name, ref in (("first", first), ("second", second)):
            check_instance(name, ref, ObjectRef, "an object that block or ball has returned")
            if ref.builder is not self:
                raise ValueError(f"{name}: expected an object of this builder, got one of another")
        return first, second

    def _pairs(self, pairs: list[tuple[ObjectRef, ObjectRef]]) -> tuple[tuple[int, int], ...]:
        """Return pairs of object indices; blocks count before balls."""
        return tuple((self._index(first), self._index(second)) for first, second in pairs)

    def _index(self, ref: ObjectRef) -> int:
        return ref.index + len(self._blocks) * ref.is_ball

"""A reference world that shows what happened inside each of its steps."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity.engines.reference import ReferenceWorld


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """One touching pair of one step, as the reference solved it.

    Attributes:
        a: object index of the pair's first body, from which the normal points.
        b: object index of the second.
        normal: (2,) float64 unit vector from a to b.
        r1: (points, 2) float64 contact points relative to the centre of a, px.
        r2: (points, 2) float64 the same relative to the centre of b.
        masses: (points, 2) float64 effective masses along normal and tangent.
        speeds: (points, 2) float64 restitution speed, and the target speed that undoes the overlap, px/s.
        impulses: (points, 3) float64 accumulated after the last sweep: normal, tangent, position correction.
    """

    a: int
    b: int
    normal: NDArray[np.float64]
    r1: NDArray[np.float64]
    r2: NDArray[np.float64]
    masses: NDArray[np.float64]
    speeds: NDArray[np.float64]
    impulses: NDArray[np.float64]


class TracedWorld(ReferenceWorld):
    """A reference world that records, step by step, how each touching pair was solved.

    Args:
        scene: see `ReferenceWorld`.
        resets: see `ReferenceWorld`.
    """

    def __init__(self, scene: Scene, resets: int = 1) -> None:
        super().__init__(scene, resets)
        self._all_constraints = list(self.constraints)
        self._index = {body: i for i, body in enumerate(self.bodies)}
        self._records: list[ContactRecord] = []
        # The callback runs once for each touching pair, in solve order.
        self.space.on_collision(post_solve=self._record)

    def _record(self, arbiter: Any, space: object, data: object) -> None:  # noqa: ANN401 - an Arbiter of pymunk
        first, second = arbiter.bodies
        raw = arbiter._arbiter  # contact records of the engine: public accessors show only sums and rounded points
        points = [raw.contacts[k] for k in range(raw.count)]

        def columns(*names: str) -> NDArray[np.float64]:
            return np.array([[getattr(point, name) for name in names] for point in points], dtype=np.float64)

        self._records.append(
            ContactRecord(
                a=self._index[first],
                b=self._index[second],
                normal=np.array([raw.n.x, raw.n.y]),
                r1=np.array([[point.r1.x, point.r1.y] for point in points]),
                r2=np.array([[point.r2.x, point.r2.y] for point in points]),
                masses=columns("nMass", "tMass"),
                speeds=columns("bounce", "bias"),
                impulses=columns("jnAcc", "jtAcc", "jBias"),
            )
        )

    def step(self, dt: float) -> list[ContactRecord]:
        """Make one step and return its touching pairs in the order in which they were solved."""
        self._records = []
        self.space.step(dt)
        return self._records

    def constraint_impulses(self) -> NDArray[np.float64]:
        """Impulse of each joint (its size) and spring in the last step, in scene order, NaN for one that is gone."""
        return np.array(
            [entry[2].impulse if entry in self.constraints else np.nan for entry in self._all_constraints],
            dtype=np.float64,
        )

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
        normal_mass: (points,) float64 effective mass along the normal.
        tangent_mass: (points,) float64 effective mass along the tangent.
        bounce: (points,) float64 restitution speed, px/s.
        bias: (points,) float64 target speed that undoes the overlap, px/s.
        normal_impulse: (points,) float64 accumulated impulse after the last sweep.
        tangent_impulse: (points,) float64 the same along the tangent.
        bias_impulse: (points,) float64 the same of the position correction.
        ids: the contact ids, which clash where two hashes agree.
    """

    a: int
    b: int
    normal: NDArray[np.float64]
    r1: NDArray[np.float64]
    r2: NDArray[np.float64]
    normal_mass: NDArray[np.float64]
    tangent_mass: NDArray[np.float64]
    bounce: NDArray[np.float64]
    bias: NDArray[np.float64]
    normal_impulse: NDArray[np.float64]
    tangent_impulse: NDArray[np.float64]
    bias_impulse: NDArray[np.float64]
    ids: tuple[int, ...]


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

        def column(name: str) -> NDArray[np.float64]:
            return np.array([getattr(point, name) for point in points], dtype=np.float64)

        self._records.append(
            ContactRecord(
                a=self._index[first],
                b=self._index[second],
                normal=np.array([raw.n.x, raw.n.y]),
                r1=np.array([[point.r1.x, point.r1.y] for point in points]),
                r2=np.array([[point.r2.x, point.r2.y] for point in points]),
                normal_mass=column("nMass"),
                tangent_mass=column("tMass"),
                bounce=column("bounce"),
                bias=column("bias"),
                normal_impulse=column("jnAcc"),
                tangent_impulse=column("jtAcc"),
                bias_impulse=column("jBias"),
                ids=tuple(int(point.hash) for point in points),
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

"""One step as either engine sees it, in object indices of the scene and in the reference's roles a and b."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from iphyre_jax.physics import State, Topology
from iphyre_jax.physics.contact_rows import ContactLayout, unpack_contact
from iphyre_jax.physics.solver import Contacts
from iphyre_jax.physics.step import Stages
from iphyre_jax.physics.vector import Vec
from parity.engines.reference import BodyState
from parity.engines.trace import ContactRecord

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Which object of the scene each body of the solver is.

    Attributes:
        topology: the compiled layout.
        moving: object index of each moving body, moving bars first.
        statics: object index of each static bar, in the solver's order.
    """

    topology: Topology
    moving: tuple[int, ...]
    statics: tuple[int, ...]

    @property
    def bars(self) -> tuple[int, ...]:
        """Object index of each bar: the moving ones, then the static ones."""
        return (*self.moving[: self.topology.bars], *self.statics)

    def pair_of(self, point_id: int) -> tuple[int, int]:
        """The two objects of a contact point, in the solver's own order (first, second)."""
        topology, pair = self.topology, point_id >> 2
        balls = self.moving[topology.bars :]
        if pair < len(topology.ball_bar_pairs):
            ball, bar = topology.ball_bar_pairs[pair]
            return balls[ball], self.bars[bar]
        pair -= len(topology.ball_bar_pairs)
        if pair < len(topology.ball_pairs):
            i, j = topology.ball_pairs[pair]
            return balls[i], balls[j]
        i, j = topology.bar_pairs[pair - len(topology.ball_pairs)]
        return self.bars[i], self.bars[j]


@dataclass(frozen=True, eq=False)
class StepView:
    """One step as either engine sees it. K contact points in solve order, M moving objects, C constraints.

    Attributes:
        pairs: (a, b) of each contact point, in the reference's roles.
        position: (M, 2) px, after the step (bodies move in its first stage).
        angle: (M,) rad.
        normal: (K, 2) from a to b.
        arm_a: (K, 2) px, contact point relative to the centre of a.
        arm_b: (K, 2) the same of b.
        separation: (K,) px along the normal, negative when overlapping.
        masses: (K, 2) effective masses along normal and tangent.
        speeds: (K, 2) bounce and bias, px/s.
        impulses: (K, 3) accumulated: normal, tangent, bias.
        constraint_impulses: (C,) accumulated impulses of joints and springs, NaN where one is gone.
        velocity: (M, 2) px/s after the step.
        angular_velocity: (M,) rad/s.
    """

    pairs: tuple[tuple[int, int], ...]
    position: Floats
    angle: Floats
    normal: Floats
    arm_a: Floats
    arm_b: Floats
    separation: Floats
    masses: Floats
    speeds: Floats
    impulses: Floats
    constraint_impulses: Floats
    velocity: Floats
    angular_velocity: Floats


def jax_view(layout: Layout, scene: Scene, state: State, stages: Stages, low_is_a: Sequence[jax.Array]) -> StepView:
    """What one of our steps computed, in the reference's roles.

    Args:
        layout: which object each body is.
        scene: the scene.
        state: after the step, NumPy arrays as all that follows.
        stages: of the step.
        low_is_a: for every pair of moving bodies, whether the body of the lower index has role a.
    """
    contact = stages.contacts
    count = min(int(stages.num_touching), layout.topology.slots)  # with more, the world ends in a fault
    columns = ContactLayout(layout.topology.bars, layout.topology.moving, exact=True)
    ids, vectors, separation, masses, speeds = jax.device_get(_unpacked(columns, contact))
    first_second = [layout.pair_of(int(point)) for point in ids[:count]]
    flip = np.array([_second_is_a(layout, state, low_is_a, pair) for pair in first_second], dtype=bool).reshape(
        count, 1
    )
    normal, one, two = (_xy(vector)[:count] for vector in vectors)
    alive = {o: bool(state.alive[s]) for s, o in enumerate(layout.statics)}
    ends = (*scene.joints, *scene.springs)
    gone = np.array([not all(alive.get(o, True) for o in pair) for pair in ends], dtype=bool)
    return StepView(
        pairs=tuple((j, i) if f else (i, j) for (i, j), f in zip(first_second, flip[:, 0], strict=True)),
        position=_xy(state.position),
        angle=np.asarray(state.angle),
        normal=np.where(flip, -normal, normal),
        arm_a=np.where(flip, two, one),
        arm_b=np.where(flip, one, two),
        separation=separation[:count],
        masses=masses[:count],
        speeds=speeds[:count],
        impulses=np.asarray(contact.impulses)[:count],
        constraint_impulses=np.where(gone, np.nan, [constraint.impulse for constraint in stages.constraints]),
        velocity=_xy(state.motion.velocity),
        angular_velocity=np.asarray(state.motion.angular_velocity),
    )


@partial(jax.jit, static_argnums=0)  # field by field it takes longer than the step
def _unpacked(
    columns: ContactLayout, contact: Contacts
) -> tuple[jax.Array, tuple[Vec, Vec, Vec], jax.Array, jax.Array, jax.Array]:
    """Ids, normals with both arms, separations, masses (K, 2) and speeds (K, 2) of contacts."""
    points, solved = contact.points.unpack(axis=1), unpack_contact(contact.packed, columns, axis=1)
    masses, speeds = (solved.normal_mass, solved.tangent_mass), (solved.bounce, solved.bias)
    vectors = points.normal, points.arm_first, points.arm_second
    return points.id, vectors, points.separation, jnp.stack(masses, axis=1), jnp.stack(speeds, axis=1)


def _second_is_a(layout: Layout, state: State, low_is_a: Sequence[jax.Array], pair: tuple[int, int]) -> bool:
    """Whether the reference calls the second object of a pair a. Against a bar, a ball is always a."""
    topology, moving = layout.topology, layout.moving
    first, second = moving.index(pair[0]), moving.index(pair[1]) if pair[1] in moving else None
    if first >= topology.bars and (second is None or second < topology.bars):
        return False
    if second is None:
        return not bool(state.broad.updated[first])
    low = bool(low_is_a[topology.pairs.index((min(first, second), max(first, second)))])
    return low != (first < second)


def _xy(vec: Vec) -> Floats:
    return np.stack([np.asarray(vec.x), np.asarray(vec.y)], axis=1)


def reference_view(
    layout: Layout, state: BodyState, records: list[ContactRecord], constraint_impulses: Floats
) -> StepView:
    """The same step as the reference saw it."""

    def rows(name: str, width: int) -> Floats:
        return np.concatenate([np.zeros((0, width)), *(np.reshape(getattr(r, name), (-1, width)) for r in records)])

    repeats = [len(record.masses) for record in records]
    pairs = tuple((r.a, r.b) for r, n in zip(records, repeats, strict=True) for _ in range(n))
    normal = np.repeat(np.concatenate([np.zeros((0, 2)), *(r.normal[None] for r in records)]), repeats, axis=0)
    a, b = (np.array([pair[k] for pair in pairs], dtype=int) for k in (0, 1))
    gap = state.position[b] - state.position[a] + (rows("r2", 2) - rows("r1", 2))
    moving = list(layout.moving)
    return StepView(
        pairs=pairs,
        position=state.position[moving],
        angle=state.angle[moving],
        normal=normal,
        arm_a=rows("r1", 2),
        arm_b=rows("r2", 2),
        separation=np.sum(gap * normal, axis=1),
        masses=rows("masses", 2),
        speeds=rows("speeds", 2),
        impulses=rows("impulses", 3),
        constraint_impulses=constraint_impulses,
        velocity=state.velocity[moving],
        angular_velocity=state.angular_velocity[moving],
    )

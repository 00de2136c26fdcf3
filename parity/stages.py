"""Compare both engines stage by stage, one step at a time, with the reference's state put into ours.

Before every step our solver takes over the reference's poses, velocities and impulses. So a difference shows in the
step and the stage that make it, not in what follows from it.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity import tolerances as tol
from parity.engines.instrumented import JaxWorld, inject_state
from parity.engines.reference import schedule
from parity.engines.trace import TracedWorld
from parity.engines.views import StepView, reference_view

ObjectPair = tuple[int, int]


@dataclass(frozen=True)
class Divergence:
    """The first stage of the first step in which the engines differ.

    Attributes:
        step: 0-based index of the step.
        stage: the stage's name.
        detail: what differs, with both values.
        knife_edge: whether a contact is there in one engine only because its separation is zero up to rounding.
    """

    step: int
    stage: str
    detail: str
    knife_edge: bool = False

    def __str__(self) -> str:
        """One line."""
        return f"step {self.step}, {self.stage}: {self.detail}"


@dataclass(frozen=True)
class _Values:
    """A stage whose numbers are compared: its name, the numbers of a view, the tolerance, relative or not."""

    stage: str
    values: Callable[[StepView], NDArray[np.float64]]
    tolerance: float
    relative: bool = False


_BEFORE_CONTACTS = (
    _Values("positions", lambda view: view.position, tol.STAGE_POSITION),
    _Values("angles", lambda view: view.angle, tol.STAGE_POSITION),
)
_FROM_CONTACTS = (
    _Values("normals", lambda view: view.normal, tol.STAGE_NORMAL),
    _Values("contact points on a", lambda view: view.arm_a, tol.STAGE_POINT),
    _Values("contact points on b", lambda view: view.arm_b, tol.STAGE_POINT),
    _Values("contact masses", lambda view: view.masses, tol.STAGE_MASS, relative=True),
    _Values("bounce and bias speeds", lambda view: view.speeds, tol.STAGE_SPEED),
    _Values("contact impulses", lambda view: view.impulses, tol.STAGE_IMPULSE),
    _Values("joints and springs", lambda view: view.constraint_impulses, tol.STAGE_IMPULSE),
    _Values("velocities", lambda view: view.velocity, tol.STAGE_VELOCITY),
    _Values("angular velocities", lambda view: view.angular_velocity, tol.STAGE_VELOCITY),
)


def compare_step(step: int, ours: StepView, theirs: StepView, pins: int, *, exact: bool = False) -> Divergence | None:
    """The first stage of one step that differs, in the order in which the stages happen.

    Args:
        step: 0-based index of the step, for the report.
        ours: our view of it.
        theirs: the reference's.
        pins: how many of the constraints are pin joints, whose impulses the reference shows without their sign.
        exact: count every difference, not only those beyond the stage's tolerance.

    Returns:
        The divergence, or None where all stages agree within their tolerances.
    """
    mine = ours.constraint_impulses.copy()
    mine[:pins] = np.abs(mine[:pins])
    ours = replace(ours, constraint_impulses=mine)
    return (
        _numbers(step, ours, theirs, _BEFORE_CONTACTS, exact)
        or _contacts(step, ours, theirs)
        or _numbers(step, ours, theirs, _FROM_CONTACTS, exact)
    )


def _numbers(
    step: int, ours: StepView, theirs: StepView, stages: tuple[_Values, ...], exact: bool
) -> Divergence | None:
    for stage in stages:
        mine, other = stage.values(ours), stage.values(theirs)
        scale = np.maximum(np.abs(other), 1e-300) if stage.relative else 1.0
        tolerance = 0.0 if exact else stage.tolerance * scale
        same = (np.abs(mine - other) <= tolerance) | (np.isnan(mine) & np.isnan(other))
        if not same.all():
            row = tuple(int(k) for k in np.argwhere(~same)[0])
            detail = f"row {row}: ours {float(mine[row])!r}, the reference's {float(other[row])!r}"
            return Divergence(step, stage.stage, detail)
    return None


def _contacts(step: int, ours: StepView, theirs: StepView) -> Divergence | None:
    """Which pairs touch in how many points, in which order, in which roles."""
    counts = [Counter(_unordered(view.pairs)) for view in (ours, theirs)]
    if counts[0] != counts[1]:
        differing = {pair for pair in {*counts[0], *counts[1]} if counts[0][pair] != counts[1][pair]}
        return Divergence(
            step,
            "contacts",
            f"points of each pair: ours {_listed(ours.pairs)}, the reference's {_listed(theirs.pairs)}",
            all(_just_touches(pair, ours, theirs) for pair in differing),
        )
    for stage, orders in (
        ("visit order", [_unordered(view.pairs) for view in (ours, theirs)]),
        ("roles", [view.pairs for view in (ours, theirs)]),
    ):
        if orders[0] != orders[1]:
            return Divergence(step, stage, f"ours {_listed(ours.pairs)}, the reference's {_listed(theirs.pairs)}")
    return None


def _unordered(pairs: tuple[ObjectPair, ...]) -> tuple[ObjectPair, ...]:
    return tuple((min(pair), max(pair)) for pair in pairs)


def _listed(pairs: tuple[ObjectPair, ...]) -> str:
    return ", ".join(f"{a}-{b}" for a, b in pairs) or "none"


def _just_touches(pair: ObjectPair, *views: StepView) -> bool:
    """Whether the separation of some point of a pair is zero up to rounding, in either view."""
    separations = [
        separation
        for view in views
        for other, separation in zip(_unordered(view.pairs), view.separation, strict=True)
        if other == pair
    ]
    return any(abs(separation) <= tol.STAGE_POINT for separation in separations)


def first_divergence(
    scene: Scene, eliminate_at: NDArray[np.integer[Any]], *, fps: int, steps: int, resets: int = 1, exact: bool = False
) -> Divergence | None:
    """Play one plan in both engines side by side and name the first stage in which they differ.

    Args:
        scene: the scene.
        eliminate_at: (S,) integers as for `iphyre_jax.simulate`.
        fps: physics steps a second.
        steps: the most steps to compare; the step that solves the game is the last.
        resets: number of the reset to play in.
        exact: let both engines run free and find the first bit that differs. Else put the reference's state into ours
            before every step and find the first difference beyond a stage's tolerance.

    Returns:
        The first divergence, or None.
    """
    for step, mine, theirs in side_by_side(scene, eliminate_at, fps=fps, steps=steps, resets=resets, free=exact):
        found = compare_step(step, mine, theirs, len(scene.joints), exact=exact)
        if found:
            return found
    return None


def side_by_side(
    scene: Scene, eliminate_at: NDArray[np.integer[Any]], *, fps: int, steps: int, resets: int, free: bool
) -> Iterator[tuple[int, StepView, StepView]]:
    """Play one plan in both engines, step by step; arguments as in `first_divergence`.

    If `free`, both run free. Else ours takes over the reference's state before every step.

    Yields:
        The step's index, our view of it, the reference's.
    """
    with jax.enable_x64(True):
        ours, theirs = JaxWorld(scene, resets, fps), TracedWorld(scene, resets)
        due = schedule(scene, eliminate_at)
        last: StepView | None = None
        for k in range(steps):
            for index in due.get(k, ()):
                ours.eliminate(index)
                theirs.eliminate(index)
            if not free:
                ours.state = inject_state(ours.layout, ours.state, theirs.state(), last)
            mine, records = ours.step(), theirs.step(1.0 / fps)
            last = reference_view(ours.layout, theirs.state(), records, theirs.constraint_impulses())
            yield k, mine, last
            if theirs.solved():
                return

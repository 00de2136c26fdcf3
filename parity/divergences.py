"""Plans that go astray, each with the step and the stage in which its first bit differs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity.compare import PlanComparison
from parity.stages import Divergence, first_divergence
from parity.tolerances import TARGETS


@dataclass(frozen=True)
class Astray:
    """One plan that ends otherwise or strays further than its target's limit.

    Attributes:
        game: the scene's name.
        fps: physics steps a second.
        dtype: the type ours ran in.
        plan: its index.
        eliminate_at: the plan.
        error: px, its largest error in play.
        reference: (solved, steps) in the reference.
        ours: the same in ours.
        fault: our fault code.
        first_bit: where the first bit differs, both engines running free; None in float32, where all bits do, for a
            fault, and where none is found in a world that is stepped alone.
        first_stage: the first difference beyond a stage's tolerance, from the reference's own state; None as above.
    """

    game: str
    fps: int
    dtype: str
    plan: int
    eliminate_at: tuple[int, ...]
    error: float
    reference: tuple[bool, int]
    ours: tuple[bool, int]
    fault: int
    first_bit: Divergence | None = None
    first_stage: Divergence | None = None


def astray(comparison: PlanComparison, fps: int, dtype: str) -> NDArray[np.intp]:
    """Indices of the plans that end differently or stray further than their target's limit."""
    c = comparison
    return np.flatnonzero(
        ~((c.error <= TARGETS[dtype, fps].error) & c.same_step & c.same_eliminations & c.same_presence)
    )


def explain(
    scene: Scene,
    eliminate_at: NDArray[np.int32],
    comparison: PlanComparison,
    plan: int,
    fps: int,
    dtype: str,
    steps: int,
    resets: int,
    *,
    traced: bool,
) -> Astray:
    """Describe one plan that goes astray.

    Args:
        scene: the scene.
        eliminate_at: (B, S) the plans.
        comparison: of all these plans.
        plan: index of the one to explain.
        fps: physics steps a second.
        dtype: the type ours ran in.
        steps: length of a play.
        resets: number of the reset.
        traced: in float64, look for the step and the stage in which it begins; a fault explains itself.

    Returns:
        The description.
    """
    c, row = comparison, eliminate_at[plan]
    found: list[Divergence | None] = [None, None]
    if traced and dtype == "float64" and not c.fault[plan]:
        found = [first_divergence(scene, row, fps=fps, steps=steps, resets=resets, exact=e) for e in (True, False)]
    return Astray(
        game=scene.name,
        fps=fps,
        dtype=dtype,
        plan=plan,
        eliminate_at=tuple(row.tolist()),
        error=float(c.error[plan]),
        reference=(bool(c.reference_success[plan]), int(c.reference_steps[plan])),
        ours=(bool(c.success[plan]), int(c.steps[plan])),
        fault=int(c.fault[plan]),
        first_bit=found[0],
        first_stage=found[1],
    )

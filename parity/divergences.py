"""Plans whose plays diverge, each with the step and the stage of its first difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity.compare import PlanComparison
from parity.stages import Divergence, first_divergence
from parity.tolerances import TARGETS


@dataclass(frozen=True)
class DivergedPlan:
    """One plan that ends differently in the two engines or exceeds its target's error.

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
        first_bit: the first bit that differs while both engines run free; None in float32, where all bits differ,
            after a fault, and if a world stepped alone shows no difference.
        first_stage: the first difference beyond a stage's tolerance, each step starting from the reference's state;
            None in the same cases.
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


def diverged_plans(comparison: PlanComparison, fps: int, dtype: str) -> NDArray[np.intp]:
    """Indices of the plans that end differently or exceed their target's error."""
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
) -> DivergedPlan:
    """Describe row `plan` of the plans (B, S), which diverges; a play has `steps` steps at most.

    If `traced`, look for the step and the stage of the first difference, in float64 and unless there is a fault.
    """
    c, row = comparison, eliminate_at[plan]
    first: list[Divergence | None] = [None, None]
    if traced and dtype == "float64" and not c.fault[plan]:
        first = [first_divergence(scene, row, fps=fps, steps=steps, resets=resets, exact=e) for e in (True, False)]
    return DivergedPlan(
        game=scene.name,
        fps=fps,
        dtype=dtype,
        plan=plan,
        eliminate_at=tuple(row.tolist()),
        error=float(c.error[plan]),
        reference=(bool(c.reference_success[plan]), int(c.reference_steps[plan])),
        ours=(bool(c.success[plan]), int(c.steps[plan])),
        fault=int(c.fault[plan]),
        first_bit=first[0],
        first_stage=first[1],
    )

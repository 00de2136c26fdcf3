"""Energy, momentum and contacts of one play in both engines, which run free side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from iphyre_jax.physics.constants import BAR_MOMENT, GRAVITY, MASS
from parity.engines.views import StepView
from parity.stages import side_by_side

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Statistics:
    """One engine's side of a play, a value a step (K,). Masses are 1, so energies are in px^2/s^2.

    Attributes:
        kinetic: of translation and rotation.
        potential: of gravity, 0 at y = 600.
        momentum_x: px/s, sum over the moving bodies.
        momentum_y: px/s.
        points: contact points.
        ball_ball: contact points between two balls.
        ball_bar: between a ball and a bar.
        bar_bar: between two bars.
        impulse: px/s, sum of the normal impulses.
        overlap: px, the deepest.
    """

    kinetic: Floats
    potential: Floats
    momentum_x: Floats
    momentum_y: Floats
    points: Floats
    ball_ball: Floats
    ball_bar: Floats
    bar_bar: Floats
    impulse: Floats
    overlap: Floats


@dataclass(frozen=True, eq=False)
class PlayStatistics:
    """The statistics of one play.

    Attributes:
        game: the scene's name.
        fps: physics steps a second.
        plan: index of the plan.
        ours: our side.
        theirs: the reference's.
    """

    game: str
    fps: int
    plan: int
    ours: Statistics
    theirs: Statistics


def play_statistics(
    scene: Scene, eliminate_at: NDArray[np.integer[Any]], *, plan: int, fps: int, steps: int, resets: int
) -> PlayStatistics:
    """Play one plan (S,) in both engines and count, in float64; `plan` is its index, for the report."""
    moment = _moments(scene)
    rows: list[tuple[list[float], list[float]]] = []
    for _, ours, theirs in side_by_side(scene, eliminate_at, fps=fps, steps=steps, resets=resets, free=True):
        rows.append((_row(scene, moment, ours), _row(scene, moment, theirs)))
    table = np.array(rows)  # (K, 2, fields)
    return PlayStatistics(scene.name, fps, plan, *(Statistics(*table[:, side].T) for side in (0, 1)))


def _moments(scene: Scene) -> Floats:
    """Moments of inertia of the moving objects, px^2."""
    bars = np.flatnonzero(scene.dynamic[: scene.n_blocks])
    return np.concatenate([np.full(len(bars), BAR_MOMENT), 0.5 * MASS * scene.balls[:, 2] ** 2])


def _row(scene: Scene, moment: Floats, view: StepView) -> list[float]:
    spin = view.angular_velocity
    balls = [sum(index >= scene.n_blocks for index in pair) for pair in view.pairs]
    return [
        0.5 * MASS * float((view.velocity**2).sum()) + 0.5 * float((moment * spin**2).sum()),
        MASS * GRAVITY * float((600.0 - view.position[:, 1]).sum()),
        MASS * float(view.velocity[:, 0].sum()),
        MASS * float(view.velocity[:, 1].sum()),
        float(len(balls)),
        *(float(balls.count(number)) for number in (2, 1, 0)),
        float(view.impulses[:, 0].sum()),
        float(np.max(-view.separation, initial=0.0)),
    ]

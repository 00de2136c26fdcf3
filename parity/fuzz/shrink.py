"""Make a scene in which the engines differ as small as possible.

A fixed list of simplifications is tried, first those that need no new program; each one that keeps the difference is
kept, until none does. Hypothesis does not fit: it shrinks the choices of a generator, and nearly every choice here
changes which bodies move, so each try would spend seconds on a new program.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity.stages import first_divergence

Plan = NDArray[np.integer[Any]]
Case = tuple[Scene, Plan]

ROUNDINGS = (10.0, 1.0, 0.125)  # px


def shrink(scene: Scene, plan: Plan, still_differs: Callable[[Scene, Plan], bool]) -> Case:
    """Simplify a scene and its plan.

    Args:
        scene: the scene.
        plan: (S,) integers as for `iphyre_jax.simulate`.
        still_differs: whether a simpler case still shows the difference.

    Returns:
        A case that loses the difference with every simplification.
    """
    case = scene, plan
    while True:
        simpler = next((candidate for candidate in _simplifications(*case) if still_differs(*candidate)), None)
        if simpler is None:
            return case
        case = simpler


def same_difference(scene: Scene, plan: Plan, *, fps: int, steps: int, resets: int) -> Callable[[Scene, Plan], bool]:
    """Return a test: does a case differ in the same stage as this one, at the same step or earlier?

    The difference is the first one beyond a stage's tolerance or, if there is none, the first different bit.

    Raises:
        ValueError: the play does not differ.
    """
    for exact in (False, True):
        found = first_divergence(scene, plan, fps=fps, steps=steps, resets=resets, exact=exact)
        if found is not None:
            break
    else:
        raise ValueError(f"{scene.name}: expected a play that differs from the reference, found none")
    first = found

    def still_differs(simpler: Scene, rows: Plan) -> bool:
        again = first_divergence(simpler, rows, fps=fps, steps=first.step + 1, resets=resets, exact=exact)
        return again is not None and again.stage == first.stage

    return still_differs


def _simplifications(scene: Scene, plan: Plan) -> Iterator[Case]:
    """Every simplification of a case in one respect, the cheapest first, if the scene stays valid."""
    for column in np.flatnonzero(plan >= 0):
        yield scene, np.where(np.arange(len(plan)) == column, -1, plan)
    order = sorted(range(scene.n_objects), key=lambda index: (bool(scene.dynamic[index]), index))
    changes: list[Callable[[], Case]] = [partial(_without_object, scene, plan, index) for index in order]
    for kind in ("joints", "springs"):
        changes += [partial(_without_constraint, scene, plan, kind, k) for k in range(len(getattr(scene, kind)))]
    changes += [partial(_not_eliminable, scene, plan, int(column)) for column in np.flatnonzero(plan < 0)]
    changes += [partial(_rounded, scene, plan, index, to) for to in ROUNDINGS for index in range(scene.n_objects)]
    for change in changes:
        try:
            candidate = change()
        except ValueError:
            continue
        if candidate[0] != scene:
            yield candidate


def _without_object(scene: Scene, plan: Plan, index: int) -> Case:
    """The scene without one object, its joints and springs, and the plan without its column."""

    def left(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((i - (i > index), j - (j > index)) for i, j in pairs if index not in (i, j))

    columns = [k for k, block in enumerate(scene.eliminable_blocks) if block != index]
    block = index < scene.n_blocks
    smaller = replace(
        scene,
        blocks=np.delete(scene.blocks, index, axis=0) if block else scene.blocks,
        balls=scene.balls if block else np.delete(scene.balls, index - scene.n_blocks, axis=0),
        eliminable=np.delete(scene.eliminable, index),
        dynamic=np.delete(scene.dynamic, index),
        joints=left(scene.joints),
        springs=left(scene.springs),
    )
    return smaller, plan[columns]


def _without_constraint(scene: Scene, plan: Plan, kind: str, k: int) -> Case:
    pairs = getattr(scene, kind)
    fewer: dict[str, Any] = {kind: (*pairs[:k], *pairs[k + 1 :])}
    return replace(scene, **fewer), plan


def _not_eliminable(scene: Scene, plan: Plan, column: int) -> Case:
    """The scene with an eliminable block that the plan never removes made a plain one."""
    eliminable = scene.eliminable.copy()
    eliminable[scene.eliminable_blocks[column]] = False
    return replace(scene, eliminable=eliminable), np.delete(plan, column)


def _rounded(scene: Scene, plan: Plan, index: int, to: float) -> Case:
    """The scene with one object's position rounded to multiples of `to` px; a ball keeps its radius."""
    if index < scene.n_blocks:
        blocks = scene.blocks.copy()
        blocks[index] = np.round(blocks[index] / to) * to
        return replace(scene, blocks=blocks), plan
    balls = scene.balls.copy()
    balls[index - scene.n_blocks, :2] = np.round(balls[index - scene.n_blocks, :2] / to) * to
    return replace(scene, balls=balls), plan

"""Make a scene that shows a difference as small as it can be while it still shows it.

Hypothesis does not fit: it shrinks the choices of a generator, and here nearly every choice changes which bodies move,
that is, what must be compiled (seconds each). So this goes through one fixed list of simplifications, those first that
need no new program, and keeps each that leaves the difference in place, until none does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Scene
from parity.stages import first_divergence

Plan = NDArray[np.integer[Any]]
Case = tuple[Scene, Plan]

ROUNDINGS = (10.0, 1.0, 0.125)  # px


def shrink(scene: Scene, plan: Plan, still: Callable[[Scene, Plan], bool]) -> Case:
    """Simplify a scene and its plan.

    Args:
        scene: the scene.
        plan: (S,) integers as for `iphyre_jax.simulate`.
        still: whether a simpler case still shows what it should.

    Returns:
        A case of which no simplification in the list shows it any more.
    """
    case = scene, plan
    while True:
        simpler = next((candidate for candidate in _simpler(*case) if still(*candidate)), None)
        if simpler is None:
            return case
        case = simpler


def same_difference(scene: Scene, plan: Plan, *, fps: int, steps: int, resets: int) -> Callable[[Scene, Plan], bool]:
    """Return the question whether a case differs from the reference in the same stage as this one, or an earlier step.

    A difference beyond a stage's tolerance is looked for; where there is none, the first bit.
    """
    for exact in (False, True):
        found = first_divergence(scene, plan, fps=fps, steps=steps, resets=resets, exact=exact)
        if found is not None:
            break
    else:
        raise ValueError(f"{scene.name}: expected a play that differs from the reference, found none")
    first = found

    def still(simpler: Scene, rows: Plan) -> bool:
        again = first_divergence(simpler, rows, fps=fps, steps=first.step + 1, resets=resets, exact=exact)
        return again is not None and again.stage == first.stage

    return still


def _simpler(scene: Scene, plan: Plan) -> Iterator[Case]:
    """All simplifications of a case by one thing, the cheapest first; those that make no valid scene are left out."""
    for column in np.flatnonzero(plan >= 0):
        yield scene, np.where(np.arange(len(plan)) == column, -1, plan)
    order = sorted(range(scene.n_objects), key=lambda index: (bool(scene.dynamic[index]), index))
    changes: list[Callable[[], Case]] = [partial(_without, scene, plan, index) for index in order]
    for kind in ("joints", "springs"):
        changes += [partial(_unlinked, scene, plan, kind, k) for k in range(len(getattr(scene, kind)))]
    changes += [partial(_kept, scene, plan, int(column)) for column in np.flatnonzero(plan < 0)]
    changes += [partial(_rounded, scene, plan, index, to) for to in ROUNDINGS for index in range(scene.n_objects)]
    for change in changes:
        try:
            candidate = change()
        except ValueError:
            continue
        if candidate[0] != scene:
            yield candidate


def _replaced(scene: Scene, **fields: Any) -> Scene:  # noqa: ANN401 - the fields of a scene
    own = {
        name: getattr(scene, name) for name in ("name", "blocks", "balls", "eliminable", "dynamic", "joints", "springs")
    }
    return Scene(**own | fields)


def _without(scene: Scene, plan: Plan, index: int) -> Case:
    """The scene without one object and its links, and the plan without its column."""

    def left(pairs: tuple[tuple[int, int], ...]) -> tuple[tuple[int, int], ...]:
        return tuple((i - (i > index), j - (j > index)) for i, j in pairs if index not in (i, j))

    columns = [k for k, block in enumerate(scene.eliminable_blocks) if block != index]
    block = index < scene.n_blocks
    smaller = _replaced(
        scene,
        blocks=np.delete(scene.blocks, index, axis=0) if block else scene.blocks,
        balls=scene.balls if block else np.delete(scene.balls, index - scene.n_blocks, axis=0),
        eliminable=np.delete(scene.eliminable, index),
        dynamic=np.delete(scene.dynamic, index),
        joints=left(scene.joints),
        springs=left(scene.springs),
    )
    return smaller, plan[columns]


def _unlinked(scene: Scene, plan: Plan, kind: str, k: int) -> Case:
    pairs = getattr(scene, kind)
    return _replaced(scene, **{kind: (*pairs[:k], *pairs[k + 1 :])}), plan


def _kept(scene: Scene, plan: Plan, column: int) -> Case:
    """The scene with a block that is never removed made one that cannot be."""
    eliminable = scene.eliminable.copy()
    eliminable[scene.eliminable_blocks[column]] = False
    return _replaced(scene, eliminable=eliminable), np.delete(plan, column)


def _rounded(scene: Scene, plan: Plan, index: int, to: float) -> Case:
    """The scene with one object's place rounded to multiples of `to` px; a ball keeps its radius."""
    if index < scene.n_blocks:
        blocks = scene.blocks.copy()
        blocks[index] = np.round(blocks[index] / to) * to
        return _replaced(scene, blocks=blocks), plan
    balls = scene.balls.copy()
    balls[index - scene.n_blocks, :2] = np.round(balls[index - scene.n_blocks, :2] / to) * to
    return _replaced(scene, balls=balls), plan

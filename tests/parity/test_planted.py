"""Errors that a port of this engine is likely to make, each planted where it matters: the comparison names its stage.

The reference itself shows how much each matters, and in which games. None of these six shows in a picture.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import load_scene
from iphyre_jax.physics import lanes, solver, tables
from iphyre_jax.physics.collision import broad_phase, contacts
from iphyre_jax.physics.order_keys import STATIC_RANKS, OrderKeyLayout
from iphyre_jax.scenes import compile as scene_compiler
from parity.engines import instrumented, views
from parity.plans import random_plans
from parity.stages import Divergence, first_divergence

pytestmark = pytest.mark.usefixtures("few_optimisations")


def slop(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(solver, "SLOP", 0.11)


def one_sweep_fewer(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(solver, "SWEEPS", 9)


def roles_fixed(patch: pytest.MonkeyPatch) -> None:
    """The body of the lower index is always a: the two points of two bars come in one fixed order."""
    right = contacts._key

    def key(info: jax.Array, index: int | None, point: Any) -> jax.Array:
        fixed = info if index is None else info.at[tables.PAIR_FIRST_IS_A].set(1)
        return right(fixed, index, point)

    patch.setattr(contacts, "_key", key)
    patch.setattr(views, "_second_is_a", lambda *_: False)  # as such a solver would have it


def order_by_index(patch: pytest.MonkeyPatch) -> None:
    """Pairs are solved by the indices of their bodies."""
    right = broad_phase.order

    def order(topology: Any, world: Any, broad: Any) -> broad_phase.OrderKeys:
        bits = OrderKeyLayout(topology.moving).inner_bits
        place = lanes.iota(topology.num_static, broad.path[0])
        static = jnp.stack([((body << bits) | place) << 1 for body in range(topology.moving)])
        other = [jnp.full_like(broad.path[0], ((i << bits) | (STATIC_RANKS + j)) << 1) for i, j in topology.pairs]
        return replace(right(topology, world, broad), static=static, moving=tuple(other))

    patch.setattr(broad_phase, "order", order)


def no_copied_unapplied_impulses(patch: pytest.MonkeyPatch) -> None:
    """A contact that was lost for a step or two begins anew."""
    patch.setattr(solver, "PERSISTENCE", 1)


def no_clash_of_ids(patch: pytest.MonkeyPatch) -> None:
    """Each point has an identity of its own, although the reference's hashes of two agree."""
    patch.setattr(scene_compiler, "point_classes", lambda first, second: np.arange(4, dtype=np.int32))


PLANTED = (
    (slop, "hole", 60, "bounce and bias speeds"),
    (one_sweep_fewer, "hole", 10, "contact impulses"),
    (roles_fixed, "angle", 10, "roles"),
    (order_by_index, "direction", 10, "visit order"),
    (no_copied_unapplied_impulses, "impulse", 60, "contact impulses"),
    pytest.param(no_clash_of_ids, "multi_ball_lever", 10, "contact impulses", marks=pytest.mark.further),
)


def found(game: str, fps: int) -> Divergence | None:
    """The first difference in any of a few plans."""
    scene = load_scene(game)
    for row in random_plans(scene, 3, fps, seed=0):
        divergence = first_divergence(scene, row, fps=fps, steps=5 * fps if fps == 60 else 150)
        if divergence:
            return divergence
    return None


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "game", "fps", "stage"), PLANTED)
def test_a_planted_error_is_caught_in_its_stage(
    plant: Callable[[pytest.MonkeyPatch], None], game: str, fps: int, stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if plant is not no_clash_of_ids:  # which is data of a world, not part of the compiled step
        step = instrumented.staged_step.__wrapped__
        anew = jax.jit(lambda *arguments: step(*arguments), static_argnums=0)
        monkeypatch.setattr(instrumented, "staged_step", anew)
    plant(monkeypatch)
    divergence = found(game, fps)
    assert divergence is not None
    assert divergence.stage == stage, str(divergence)
    assert not divergence.knife_edge

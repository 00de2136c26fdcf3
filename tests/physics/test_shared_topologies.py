"""Worlds of a topology that has more constraints than they need: the same bits, whatever is absent, and where."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax import physics
from iphyre_jax.physics.shared_topologies import MOST, can_play, shared_topologies, with_absent, without_absent
from iphyre_jax.physics.types import ABSENT, STATIC, Topology
from iphyre_jax.scenes.compile import compile_scene, step_timing, topology_of
from tests.physics.worlds import make_scene
from tests.trees import assert_equal_trees

BARS = [(100.0, 500.0, 200.0, 520.0), (400.0, 500.0, 500.0, 480.0), (250.0, 300.0, 350.0, 300.0)]
BALLS = [(100.0, 100.0, 20.0), (180.0, 160.0, 20.0), (400.0, 100.0, 20.0)]
TIES = {  # objects 0 to 2 are the bars, 3 to 5 the balls
    "none": ((), ()),
    "one pin": (((0, 3),), ()),
    "a pin and a spring": (((3, 4),), ((1, 5),)),
    "four, two at a bar": (((0, 3), (1, 4)), ((0, 5), (2, 3))),
    "the spring takes the place of the first pin": (((0, 5), (3, 4)), ((2, 3),)),
}
MORE = {  # the constraints of a shared topology with those of another one
    "one": lambda own: replace(own, pins=(*own.pins, (STATIC, 2))),
    "two": lambda own: replace(own, pins=((0, 2), *own.pins), springs=(*own.springs, (STATIC, 1))),
    "many, also between": lambda own: replace(
        own,
        pins=((0, 2), *(one for end in own.pins for one in (end, (STATIC, 2)))),
        springs=((STATIC, 1), *own.springs, (1, 2)),
    ),
}
FRAMES = 40
AS_FOR_USERS = {
    "xla_cpu_use_fusion_emitters": True,
    "xla_backend_optimization_level": 3,
    "xla_llvm_disable_expensive_passes": False,
}
REMOVED = {10: 0, 25: 1}  # before which step which bar goes


def _play(topology: Topology, world: Any, timing: Any) -> Any:
    """Return the state after each step; columns of the plan are the bars."""

    def one(state: Any, k: jax.Array) -> tuple[Any, Any]:
        column = jnp.full((), -2, jnp.int32)
        for step, bar in REMOVED.items():
            column = jnp.where(k == step, bar, column)
        state = physics.eliminate(topology, world, state, world.plan_slot == column)
        state = physics.step(topology, world, timing, state)
        return state, state

    return jax.lax.scan(one, physics.initial_state(topology, world), jnp.arange(FRAMES))[1]


@pytest.mark.parametrize(
    ("ties", "more", "dtype"),
    [
        pytest.param("none", "one", "float64", marks=pytest.mark.further),
        pytest.param("none", "two", "float64", marks=pytest.mark.further),
        pytest.param("one pin", "one", "float64", marks=pytest.mark.further),
        pytest.param("a pin and a spring", "one", "float32", marks=pytest.mark.further),
        pytest.param("a pin and a spring", "many, also between", "float32", marks=pytest.mark.further),
        pytest.param("a pin and a spring", "many, also between", "float64", marks=pytest.mark.further),
        pytest.param("the spring takes the place of the first pin", "two", "float32", marks=pytest.mark.further),
        ("four, two at a bar", "many, also between", "float64"),
        pytest.param("the spring takes the place of the first pin", "two", "float64", marks=pytest.mark.further),
    ],
)
def test_absent_constraints_change_no_bit(ties: str, more: str, dtype: str) -> None:
    """Bars that hold constraints go on the way; from three constraints on the last one takes the place of theirs."""
    with jax.enable_x64(dtype == "float64"):
        pins, springs = TIES[ties]
        scene = make_scene(BALLS, BARS, joints=pins, springs=springs)
        own, world = compile_scene(scene, dtype=dtype)
        shared, timing = MORE[more](own), step_timing(60, dtype)
        # Float32 keeps its bits from program to program as users' are compiled, not with few optimisations.
        options = AS_FOR_USERS if dtype == "float32" else None
        play = jax.jit(_play, static_argnums=0, compiler_options=options)
        alone, among = play(own, world, timing), play(shared, with_absent(shared, own, world), timing)
        assert (np.asarray(world.plan_slot)[:3] >= 0).all()
        for name in ("position", "angle", "motion", "alive", "cache", "broad"):
            assert_equal_trees(getattr(among, name), getattr(alone, name))
        moved = np.asarray(alone.position.x)
        assert np.abs(moved[-1] - moved[0]).max() > 1 or ties == "none"


def test_what_is_absent_can_be_left_out_again() -> None:
    scene = make_scene(BALLS, BARS, joints=TIES["four, two at a bar"][0], springs=TIES["four, two at a bar"][1])
    own, world = compile_scene(scene)
    shared = MORE["many, also between"](own)
    padded = with_absent(shared, own, world)
    assert (padded.anchor_static == ABSENT).sum() == len(shared.constraint_ends) - 4
    topology, again = without_absent(shared, padded)
    assert topology == own
    assert_equal_trees(again, world)


def test_the_forty_games_share_seven_topologies() -> None:
    """Those that differ in pins and springs alone; each game is played by one of them."""
    games = [topology_of(iphyre_jax.load_scene(game)) for game in iphyre_jax.GAMES]
    shared = shared_topologies(games)
    bodies = {(one.bars, one.balls) for one in games}
    assert (len(shared), len(bodies), len(set(games))) == (7, 7, 16)
    assert all(sum(can_play(one, own) for one in shared) == 1 for own in games)


def test_a_shared_topology_keeps_the_order_of_each_list() -> None:
    ball = Topology(bars=0, balls=3, num_static=10, pins=(), springs=(), slots=12)
    one, other = replace(ball, pins=((0, 1), (STATIC, 2))), replace(ball, pins=((STATIC, 2), (0, 1)))
    (shared,) = shared_topologies([one, other, ball])
    assert shared_topologies([ball, other, one, one]) == (shared,)
    assert len(shared.pins) == 3
    assert all(can_play(shared, each) for each in (one, other, ball))
    assert not can_play(one, other)
    with pytest.raises(ValueError, match=r"^shared: expected the bodies and constraints of .*, got .*$"):
        with_absent(one, other, compile_scene(make_scene(BALLS, BARS))[1])


def test_too_many_constraints_are_not_joined() -> None:
    ball = Topology(bars=0, balls=3, num_static=10, pins=(), springs=(), slots=12)
    pins, springs = (replace(ball, **{kind: ((0, 1),) * (MOST - 1)}) for kind in ("pins", "springs"))
    assert set(shared_topologies([pins, springs])) == {pins, springs}
    full = replace(ball, pins=((0, 1),) * (MOST + 1))
    assert set(shared_topologies([full, ball])) == set(shared_topologies([ball, full])) == {full, ball}
    assert set(shared_topologies([replace(ball, slots=16), ball])) == {replace(ball, slots=16), ball}

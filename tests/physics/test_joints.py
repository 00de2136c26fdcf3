"""Pins and springs against formulae: forces, corrected speeds, damping, order, and what a removed bar leaves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import physics
from iphyre_jax.physics import joints, solver
from iphyre_jax.physics.constants import BIAS_BASE
from iphyre_jax.physics.types import Motion
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.physics.geometry import dot, number, vec
from tests.physics.worlds import make_scene

FPS = 60
DT = 1 / FPS
BAR, FAR_BAR = (100.0, 500.0, 200.0, 520.0), (400.0, 500.0, 500.0, 480.0)
STARTS = [(100.0, 100.0, 20.0), (180.0, 160.0, 20.0), (400.0, 100.0, 20.0), (430.0, 140.0, 20.0)]
MOVED = np.array([90 + 110j, 190 + 155j, 380 + 90j, 440 + 150j])  # where the balls are now
VELOCITY = np.array([30 - 20j, -50 + 10j, 5 + 40j, 70 - 60j])
PIN_IMPULSE = 3.5
KINDS = {"between balls": ((2, 3), (4, 5)), "with bars": ((0, 3), (4, 1))}  # the pin and the spring


@pytest.fixture(autouse=True)
def float64() -> Iterator[None]:
    with jax.enable_x64(True):
        yield


def world_of(joint_pairs: Any, springs: Any = ()) -> Any:
    """Return topology and world of two static bars and four balls, objects 2 .. 5, and how these have moved."""
    topology, world = compile_scene(make_scene(STARTS, [BAR, FAR_BAR], joints=joint_pairs, springs=springs))
    velocity, still, zero = vec(VELOCITY), vec(np.zeros(4)), jnp.zeros(4)
    impulse = jnp.full(len(joint_pairs), PIN_IMPULSE)
    changes = {"position": vec(MOVED), "motion": Motion(velocity, zero, still, zero), "pin_impulse": impulse}
    return topology, world, changes


def _prepare(topology: Any, world: Any, changes: dict[str, Any]) -> Any:
    """Return timing, constraints, velocities and solve order of a world after changes of its first state."""
    timing, state = step_timing(FPS, "float64"), replace(physics.initial_state(topology, world), **changes)
    constraints = joints.prepare(topology, world, timing, state)
    return timing, constraints, solver.unstack(state.motion, topology.moving), joints.solve_order(state.constraint_rank)


@partial(jax.jit, static_argnums=0)
def _stages(topology: Any, world: Any, changes: dict[str, Any]) -> dict[str, Any]:
    """Return what each function makes of the same constraints and velocities."""
    timing, constraints, bodies, order = _prepare(topology, world, changes)
    once = joints.sweep(topology, timing, constraints, bodies, order)
    twice = joints.sweep(topology, timing, *once, order)
    return {
        "constraints": constraints,
        "springs": joints.apply_springs(topology, constraints, bodies, order),
        "cached": joints.apply_cached(topology, constraints, bodies, order),
        "once": once[1],
        "constraints once": once[0],
        "twice": twice[1],
        "constraints twice": twice[0],
    }


@partial(jax.jit, static_argnums=0)
def _one_sweep(topology: Any, world: Any, changes: dict[str, Any]) -> Any:
    timing, constraints, bodies, order = _prepare(topology, world, changes)
    return constraints, joints.sweep(topology, timing, constraints, bodies, order)[1]


def velocities(motions: Any) -> Any:
    return np.array([number(motion.velocity) for motion in motions])


def of_ends(pair: tuple[int, int], values: Any, static: Any) -> Any:
    """Return the values at both ends of a constraint."""
    return [values[i - 2] if i >= 2 else static[i] for i in pair]


@pytest.mark.parametrize("kind", KINDS)
def test_pins_and_springs_by_their_formulae(kind: str) -> None:
    pin, spring = KINDS[kind]
    topology, world, changes = world_of([pin], [spring])
    found = _stages(topology, world, changes)
    centres = [150 + 510j, 450 + 490j]
    movers = {pair: [i - 2 for i in pair if i >= 2] for pair in (pin, spring)}
    for k, pair in enumerate((pin, spring)):
        i, j = of_ends(pair, MOVED, centres)
        way, normal = abs(j - i), (j - i) / abs(j - i)
        share = 1 / len(movers[pair])  # mass of the link, the bodies' being 1
        start = of_ends(pair, [complex(x, y) for x, y, _ in STARTS], centres)
        length = abs(start[1] - start[0])
        link, after = found["constraints"][k], found["constraints once"][k]
        np.testing.assert_allclose(number(link.normal), normal, rtol=1e-14)
        before = of_ends(pair, VELOCITY, [0, 0])
        speed = dot(before[1] - before[0], normal)
        if k == 0:
            wanted = -(1 - BIAS_BASE**DT) * (way - length) / DT
            np.testing.assert_allclose([link.target, link.impulse], [wanted, PIN_IMPULSE], rtol=1e-12)
            gained = (wanted - speed) * share
        else:
            np.testing.assert_allclose([link.target, link.impulse], [0, (20 - way) * DT], rtol=1e-12)
            wanted = speed * math.exp(-0.3 * DT * len(movers[pair]))
            gained = (wanted - speed) * share
        np.testing.assert_allclose(after.impulse - link.impulse, gained, rtol=1e-11)
        applied = found["cached" if k == 0 else "springs"]
        for stage, size in ((applied, float(link.impulse)), (found["once"], gained), (found["twice"], gained)):
            for sign, body in zip((-1, 1), pair, strict=True):
                if body >= 2:
                    change = velocities(stage)[body - 2] - VELOCITY[body - 2]
                    np.testing.assert_allclose(change, sign * size * normal, atol=1e-11)
        unlike = found["springs" if k == 0 else "cached"]
        np.testing.assert_array_equal(velocities(unlike)[movers[pair]], VELOCITY[movers[pair]])


def test_the_bias_leaves_its_share_of_the_error_after_a_second() -> None:
    """One step at the wanted speed leaves 1 - bias of the error, all steps of a second the base."""
    pin, spring = KINDS["between balls"]
    topology, world, changes = world_of([pin], [spring])
    link = _stages(topology, world, changes)["constraints"][0]
    error = abs(MOVED[1] - MOVED[0]) - 100
    np.testing.assert_allclose((error + float(link.target) * DT) / error, BIAS_BASE**DT, rtol=1e-12)
    for fps in (10, 60):
        np.testing.assert_allclose((1 - float(step_timing(fps, "float64").bias)) ** fps, BIAS_BASE, rtol=1e-12)


def test_a_removed_bar_lets_go() -> None:
    pin, spring = KINDS["with bars"]
    topology, world, changes = world_of([pin], [spring])
    found = _stages(topology, world, changes | {"alive": np.zeros(topology.num_static, bool)})
    for stage in ("springs", "cached", "once", "twice"):
        np.testing.assert_array_equal(velocities(found[stage]), VELOCITY, stage)
    assert found["constraints twice"][0].impulse == PIN_IMPULSE


def test_a_spring_between_two_centres_in_one_does_not_pull() -> None:
    pin, spring = KINDS["between balls"]
    topology, world, changes = world_of([pin], [spring])
    found = _stages(topology, world, changes | {"position": vec([*MOVED[:3], MOVED[2]])})
    assert number(found["constraints"][1].normal) == 0
    np.testing.assert_array_equal(velocities(found["springs"]), VELOCITY)
    np.testing.assert_array_equal(velocities(found["once"])[2:], VELOCITY[2:])


@pytest.mark.parametrize("rank", [(0, 1, 2), (2, 0, 1), (1, -1, 0)])
def test_a_sweep_goes_by_the_places_in_the_list(rank: tuple[int, ...]) -> None:
    """A chain of three pins, each pushed on by the one before; a removed pin has the rank -1."""
    pins = [(2, 3), (3, 4), (4, 5)]
    topology, world, changes = world_of(pins)
    constraints, after = _one_sweep(topology, world, changes | {"constraint_rank": np.array(rank, np.int32)})
    expected = VELOCITY.copy()
    for k in sorted((k for k in range(3) if rank[k] >= 0), key=lambda k: rank[k]):
        link, (i, j) = constraints[k], (pins[k][0] - 2, pins[k][1] - 2)
        normal = number(link.normal)
        push = (float(link.target) - dot(expected[j] - expected[i], normal)) / 2 * normal
        expected[i], expected[j] = expected[i] - push, expected[j] + push
    np.testing.assert_allclose(velocities(after), expected, atol=1e-11)


def test_the_last_constraint_takes_the_hole_of_a_removed_one() -> None:
    """Against a Python list, for all orders in which three bars go, alone or together."""
    pins, springs = [(0, 3), (1, 4), (2, 5), (0, 4)], [(1, 5), (2, 3)]
    bars = [BAR, FAR_BAR, (250.0, 300.0, 350.0, 300.0)]
    topology, world = compile_scene(make_scene(STARTS[:3], bars, joints=pins, springs=springs))

    @jax.jit
    def close(rank: Any, before: Any, after: Any) -> jax.Array:
        state = replace(physics.initial_state(topology, world), constraint_rank=rank, alive=before)
        return joints.close_holes(topology, world, state, after)

    for order in itertools.permutations(range(3)):
        for groups in ([order[:1], order[1:2], order[2:]], [order[:1], order[1:]], [order[:2], order[2:]], [order]):
            rank, alive, left = np.arange(6, dtype=np.int32), np.asarray(world.valid), list(range(6))
            for group in groups:
                before, alive = alive, alive & ~np.isin(world.plan_slot, group)
                rank = close(rank, before, alive)
                for bar in sorted(group):
                    for k in [k for k, pair in enumerate(pins + springs) if bar in pair]:
                        hole = left.index(k)
                        left[hole] = left[-1]
                        left.pop()
                assert rank.tolist() == [left.index(k) if k in left else -1 for k in range(6)]

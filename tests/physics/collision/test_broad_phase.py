"""Fat boxes by hand; tree, re-insertions, order and roles against a pymunk space in which bodies fly about."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pymunk
import pytest

from iphyre_jax import physics
from iphyre_jax.physics.collision import broad_phase
from iphyre_jax.physics.collision.contacts import KEY_NONE
from iphyre_jax.physics.order_keys import COUNTER_START, STATIC_RANKS, OrderKeyLayout
from iphyre_jax.physics.types import Box, BroadPhase
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.compile import compile_scene, static_order
from parity.engines.reference import ReferenceWorld
from tests.physics.geometry import vec
from tests.physics.worlds import make_scene

EVERYWHERE = pymunk.BB(-1e4, -1e4, 1e4, 1e4)
STATIC = [
    (200.0, 200.0, 300.0, 220.0),
    (260.0, 300.0, 260.0, 180.0),
    (150.0, 260.0, 330.0, 260.0),
    (210.0, 330.0, 300.0, 310.0),
]
MOVING = [(200.0, 240.0, 260.0, 230.0), (240.0, 280.0, 320.0, 300.0)]
BALLS = [(220.0, 220.0, 20.0), (280.0, 250.0, 35.0), (250.0, 290.0, 12.0)]
SCENES: dict[str, tuple[Any, Any, Any, int, int]] = {  # last: resets of the space and steps
    "one ball": (STATIC, (), BALLS[:1], 1, 60),
    "two balls": (STATIC[:2], (), BALLS[:2], 1, 60),
    "bars and balls": (STATIC, MOVING, BALLS, 3, 200),  # in the third reset leaf order is not index order
}


def box(left: Any, top: Any, right: Any, bottom: Any) -> Box:
    return Box(*(jnp.asarray(np.array(side, float)) for side in (left, top, right, bottom)))


def sides(of: Any) -> Any:
    return np.array([of.left, of.top, of.right, of.bottom])


def test_fat_boxes_reach_a_tenth_of_the_size_and_of_the_way_ahead() -> None:
    """At rest, slow, fast to the right and up; with the reference's tenth, which is a float32 one."""
    tenth = float(np.float32(0.1))
    with jax.enable_x64(True):
        four = [[100.0] * 4, [200.0] * 4, [140.0] * 4, [260.0] * 4]  # 40 wide, 60 high
        fat = sides(broad_phase.grow(box(*four), vec([0, 30 - 50j, 400 + 0j, 10 - 900j])))
    margins = np.array([[40, 60, 40, 60], [40, 60, 40, 60], [40, 60, 400, 60], [40, 900, 40, 60]]).T
    np.testing.assert_allclose(fat, np.array(four) + tenth * margins * np.array([[-1], [-1], [1], [1]]), rtol=1e-15)


def test_boxes_that_share_a_border_overlap_and_contain() -> None:
    one = box([0] * 5, [0] * 5, [10] * 5, [20] * 5)
    other = box([10, 10.001, 2, 0, 0], [20, 5, 3, 0, -0.001], [30, 30, 8, 10, 10], [40, 9, 9, 20, 20])
    with jax.enable_x64(True):
        assert broad_phase.overlap(one, other).tolist() == [True, False, True, True, True]
        assert broad_phase.overlap(other, one).tolist() == [True, False, True, True, True]
        assert broad_phase.contains(one, other).tolist() == [False, False, True, True, False]


@dataclass
class Flight:
    """What a flight of bodies, which pass through each other, showed in pymunk and in our broad phase, by steps."""

    static: list[int]
    movers: list[int]
    visited: list[list[tuple[int, int]]] = field(default_factory=list)  # touching pairs in pymunk's order, a before b
    tree: list[list[int]] = field(default_factory=list)  # moving bodies in the order of pymunk's tree
    boxes: list[Any] = field(default_factory=list)  # exact ones, (4, n)
    velocities: list[Any] = field(default_factory=list)  # (n,), of the step before
    ours: list[BroadPhase] = field(default_factory=list)
    orders: list[dict[str, Any]] = field(default_factory=list)


@cache
def fly(name: str) -> Flight:
    """Play a scene with new random velocities every few steps, at rest at the start."""
    static, moving, balls, resets, steps = SCENES[name]
    scene, generator = make_scene(balls, static, moving), np.random.default_rng(3)
    reference, movers = ReferenceWorld(scene, resets, gravity=0), [i for i, moves in enumerate(scene.dynamic) if moves]
    seen = Flight(list(static_order(scene)), movers)

    def pass_through(arbiter: Any, *_: Any) -> None:
        seen.visited[-1].append((reference.bodies.index(arbiter.bodies[0]), reference.bodies.index(arbiter.bodies[1])))
        arbiter.process_collision = False

    reference.space.on_collision(pre_solve=pass_through)
    with jax.enable_x64(True):
        topology, world = compile_scene(scene, resets=resets)
        broad = jax.jit(partial(physics.initial_state, topology))(world).broad

        @jax.jit
        def update(broad: BroadPhase, box: Box, velocity: Vec, step: Any) -> tuple[BroadPhase, dict[str, Any]]:
            broad = broad_phase.update(topology, world, broad, box, velocity, step)
            return broad, vars(broad_phase.order(topology, world, broad))

        for step in range(steps):
            seen.velocities.append(np.array([complex(*reference.bodies[i].velocity) for i in movers]))
            seen.visited.append([])
            reference.space.step(1 / 60)
            now = [reference.shapes[i].bb for i in movers]
            seen.boxes.append(
                np.array([[b.left for b in now], [b.bottom for b in now], [b.right for b in now], [b.top for b in now]])
            )
            hits = reference.space.bb_query(EVERYWHERE, pymunk.ShapeFilter())
            seen.tree.append([i for i in map(reference.shapes.index, hits) if i in movers])
            broad, order = update(broad, box(*seen.boxes[-1]), vec(seen.velocities[-1]), np.int32(step))
            seen.ours.append(jax.tree.map(np.asarray, broad))
            seen.orders.append(jax.tree.map(np.asarray, order))
            for i in movers if step % 7 == 2 else []:  # towards the middle
                aim = np.array([250.0, 255.0]) + generator.uniform(-120, 120, 2) - reference.bodies[i].position
                reference.bodies[i].velocity = tuple((2 * aim).tolist())
                reference.bodies[i].angular_velocity = generator.uniform(-4, 4)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_body_is_inserted_anew_exactly_when_it_leaves_its_fat_box(name: str) -> None:
    seen = fly(name)
    left = 0
    for step in range(1, len(seen.ours)):
        before, after = seen.ours[step - 1 : step + 1]
        exact, velocity = seen.boxes[step], seen.velocities[step]
        old = sides(before.fat)
        outside = (exact[:2] < old[:2]).any(0) | (exact[2:] > old[2:]).any(0)
        np.testing.assert_array_equal(after.updated, outside)
        np.testing.assert_array_equal(sides(after.fat)[:, ~outside], old[:, ~outside])
        with jax.enable_x64(True):
            new = sides(broad_phase.grow(box(*exact), vec(velocity)))
        np.testing.assert_array_equal(sides(after.fat)[:, outside], new[:, outside])
        left += int(outside.sum())
    assert len(seen.ours) / 10 < left < len(seen.ours) * len(seen.movers) / 2


@pytest.mark.parametrize("name", ["two balls", "bars and balls"])
def test_the_tree_of_moving_bodies_is_pymunks(name: str) -> None:
    seen = fly(name)
    for tree, broad in zip(seen.tree, seen.ours, strict=True):
        assert [seen.movers[k] for k in np.argsort(broad.path)] == tree
        assert np.asarray(broad_phase.ranks(broad.path)).tolist() == [tree.index(i) for i in seen.movers]
        assert sum(0.5 ** broad.depth.astype(float)) == 1
    assert len({tuple(tree) for tree in seen.tree}) >= min(len(seen.movers), 8)


@pytest.mark.parametrize("name", SCENES)
def test_touching_pairs_are_visited_in_pymunks_order_and_roles(name: str) -> None:
    """A ball is always a against a bar; the owner of a pair is a on the step of its insertion."""
    seen, shared = fly(name), 0
    bars, kinds = len(SCENES[name][1]), set()
    pairs = [(i, j) for i in range(len(seen.movers)) for j in range(i + 1, len(seen.movers))]
    for visited, order, broad in zip(seen.visited, seen.orders, seen.ours, strict=True):
        keys = []
        for a, b in visited:
            if a in seen.movers and b in seen.movers:
                i, j = sorted((seen.movers.index(a), seen.movers.index(b)))
                pair = pairs.index((i, j))
                keys.append(int(order["moving"][pair]))
                if (i < bars) == (j < bars):
                    assert bool(order["low_is_a"][pair]) == (a < b)
                    kinds.add((bool(order["by_owner"][pair]), a < b))
            else:
                mover = seen.movers.index(a if a in seen.movers else b)
                keys.append(int(order["static"][mover, seen.static.index(b if a in seen.movers else a)]))
                if mover < bars:
                    assert (a in seen.movers) == broad.updated[mover]
        assert keys == sorted(set(keys))
        assert all(key % 2 == 0 and 0 <= key < KEY_NONE for key in keys)
        shared += len(keys) > 1
    assert shared >= len(seen.visited) / 4
    assert len(kinds) == 4 or len(seen.movers) < 5


@pytest.mark.parametrize("moving", range(1, 16))
def test_counters_and_keys_fit_into_31_bits(moving: int) -> None:
    c = OrderKeyLayout(moving)
    place = STATIC_RANKS + (moving - 1) * moving + moving - 1  # of the nearest relatives
    assert place < c.per_rank
    assert (moving - 1) * c.per_rank + place < c.per_step
    last = COUNTER_START + (c.max_steps - 1) * c.per_step + (moving - 1) * c.per_rank + place
    assert last <= c.newest
    largest = ((moving - 1) << c.inner_bits | (c.newest - 1)) << 1 | 1  # counters begin with 1
    assert largest < KEY_NONE
    assert {7: 131070, 12: 16382}.get(moving, c.max_steps) == c.max_steps

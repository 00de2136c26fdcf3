"""The broad phase before the first step against a pymunk space that was filled with the same shapes."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pymunk
import pytest
from pymunk._chipmunk_cffi import ffi, lib

import iphyre_jax
from iphyre_jax import Scene
from iphyre_jax.physics.collision import initial_order
from iphyre_jax.physics.collision.initial_order import Insertion
from iphyre_jax.physics.constants import HASH_COEFFICIENT, LEAF_TABLE_SIZES
from iphyre_jax.scenes.limits import Limits
from parity.engines.trace import TracedWorld
from tests.physics.worlds import make_scene

EVERYWHERE = pymunk.BB(-1e4, -1e4, 1e4, 1e4)
KINDS = {"few": (3, 1, 1), "five": (4, 2, 3), "many": (9, 3, 5), "movers": (0, 6, 8)}  # static bars, moving bars, balls


def crowd(kind: str, seed: int) -> Scene:
    """Draw a scene whose shapes lie thick: most pairs of boxes overlap. Static and moving bars are mixed."""
    generator = np.random.default_rng(seed)
    static, moving, balls = KINDS[kind]
    side = 200 + 20 * sum(KINDS[kind])
    ends = generator.integers(200, side, (static + moving, 2, 2)).astype(float)
    ends[:, 1] += 0.5  # no bar without length
    moves = generator.permutation([False] * static + [True] * moving).tolist() + [True] * balls
    discs = np.column_stack([generator.integers(200, side, (balls, 2)), generator.integers(10, 40, balls)])
    eliminable = [False] * len(moves)
    return Scene("crowd", ends.tolist(), discs.astype(float).tolist(), eliminable, moves, (), (), limits=Limits(20, 6))


def replay(world: Any, resets: int) -> Insertion:
    """Replay the insertion with the boxes that pymunk's own shapes have."""
    boxes = []
    for shape in world.shapes:
        box = shape.cache_bb()
        boxes.append((box.left, box.bottom, box.right, box.top))  # y points down, so its bottom is the smaller y
    return initial_order.replay_insertion(boxes, list(world.scene.dynamic), resets)


def by_tree(insertion: Insertion) -> list[int]:
    """Return the moving bodies as their path bits order them."""
    return sorted(insertion.path, key=lambda i: insertion.path[i])


def may_touch(world: Any) -> set[tuple[int, int]]:
    """Return the pairs whose boxes overlap, with a margin around those that move; two static shapes are no pair."""
    boxes = []
    for shape, moves in zip(world.shapes, world.scene.dynamic, strict=True):
        box, margin = shape.cache_bb(), 0.1 * moves
        width, height = (box.right - box.left) * margin, (box.top - box.bottom) * margin
        boxes.append(pymunk.BB(box.left - width, box.bottom - height, box.right + width, box.top + height))
    every = itertools.combinations(range(len(boxes)), 2)
    return {(i, j) for i, j in every if world.scene.dynamic[[i, j]].any() and boxes[i].intersects(boxes[j])}


def iteration_order(world: Any) -> list[int]:
    """Return the moving shapes in the order in which the space's own loop over them goes."""
    handles, seen = [ffi.cast("uintptr_t", shape._shape) for shape in world.shapes], []

    @ffi.callback("void(cpShape *, void *)")
    def visit(shape: Any, _: Any) -> None:
        seen.append(handles.index(ffi.cast("uintptr_t", shape)))

    lib.cpSpaceEachShape(world.space._space, visit, ffi.NULL)
    return [i for i in seen if world.scene.dynamic[i]]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", KINDS)
def test_both_trees_are_read_in_pymunks_order(kind: str, seed: int) -> None:
    world = TracedWorld(crowd(kind, seed))
    found = [world.shapes.index(shape) for shape in world.space.bb_query(EVERYWHERE, pymunk.ShapeFilter())]
    insertion, moves = replay(world, 1), world.scene.dynamic
    assert by_tree(insertion) == [i for i in found if moves[i]]
    assert list(insertion.static_order) == [i for i in found if not moves[i]]


@pytest.mark.parametrize("seed", range(4))
def test_equally_good_places_in_the_tree_are_chosen_as_pymunk_does(seed: int) -> None:
    """Bars in a regular grid at whole numbers, put in by chance."""
    corners = [(200.0 + 40 * (k % 3), 200.0 + 40 * (k // 3)) for k in np.random.default_rng(seed).permutation(9)]
    bars = [(x, y, x + 20, y) for x, y in corners]
    scene = make_scene([(100, 100, 20)], bars, eliminable=False)
    world = TracedWorld(scene)
    found = [world.shapes.index(shape) for shape in world.space.bb_query(EVERYWHERE, pymunk.ShapeFilter())]
    assert list(replay(world, 1).static_order) == found[1:]


@pytest.mark.parametrize("resets", [1, 2, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_moving_shapes_are_visited_in_pymunks_order(kind: str, resets: int) -> None:
    """Their table grows with the fifth and with the thirteenth; ids count on over resets."""
    world = TracedWorld(crowd(kind, 7), resets)
    assert list(replay(world, resets).leaf_order) == iteration_order(world)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", KINDS)
def test_the_first_contacts_come_in_pymunks_order(kind: str, seed: int) -> None:
    """By the owner's rank, and of one owner's pairs the last inserted first; the mover of higher rank owns a pair."""
    world = TracedWorld(crowd(kind, seed))
    insertion, moves = replay(world, 1), world.scene.dynamic
    rank = {i: k for k, i in enumerate(by_tree(insertion))}
    visited = [(min(pair.a, pair.b), max(pair.a, pair.b)) for pair in world.step(1e-6)]
    assert len(visited) > len(moves) / 3
    counter = insertion.counter
    assert set(counter) == may_touch(world)
    assert sorted(counter.values()) == list(range(1, len(counter) + 1))
    assert visited == sorted(visited, key=lambda pair: (max(rank.get(i, -1) for i in pair), -counter[pair]))


def test_path_bits_are_those_of_a_tree() -> None:
    """Left-aligned; no leaf's bits begin another's; together they fill the tree."""
    insertion = replay(TracedWorld(crowd("many", 0)), 1)
    bits = len(insertion.path) - 1
    codes = [format(insertion.path[i], f"0{bits}b") for i in insertion.path]
    starts = [code[: insertion.depth[i]] for i, code in zip(insertion.path, codes, strict=True)]
    assert sum(0.5 ** len(start) for start in starts) == 1
    assert not any(a is not b and b.startswith(a) for a in starts for b in starts)
    assert all(set(code[len(start) :]) <= {"0"} for code, start in zip(codes, starts, strict=True))
    lone = initial_order.replay_insertion([(0.0, 0.0, 1.0, 1.0)], [True], 1)
    assert (lone.path, lone.depth, lone.counter) == ({0: 0}, {0: 0}, {})


def test_fat_boxes_and_ids_by_hand() -> None:
    margin = float(np.float32(0.1))
    assert initial_order.grown((10.0, 20.0, 30.0, 120.0)) == (
        10 - 20 * margin,
        20 - 100 * margin,
        30 + 20 * margin,
        120 + 100 * margin,
    )
    assert initial_order.point_classes(0, 1).tolist() == [0, 1, 1, 0]  # equal hashes in a fresh space
    for ids in ((3, 7), (11, 2)):
        symmetric = [ids[0] * HASH_COEFFICIENT % 2**64 ^ end * HASH_COEFFICIENT for end in (0, 1)]
        assert symmetric[0] != symmetric[1]
        assert initial_order.point_classes(*ids).tolist() == [0, 1, 2, 3]


def filled_one_by_one(movers: list[int], n_objects: int, resets: int) -> tuple[int, ...]:
    """Fill the chained hash table as often as the reference does."""
    size = LEAF_TABLE_SIZES[0]
    chains: list[list[int]] = []
    for reset in range(resets):
        chains = [[] for _ in range(size)]
        for entries, mover in enumerate(movers, start=1):
            shape = reset * n_objects + mover
            chains[shape % size].insert(0, shape)
            if entries >= size:
                size, old = LEAF_TABLE_SIZES[LEAF_TABLE_SIZES.index(size) + 1], chains
                chains = [[] for _ in range(size)]
                for one in (one for chain in old for one in chain):
                    chains[one % size].insert(0, one)
    return tuple(one - (resets - 1) * n_objects for chain in chains for one in chain)


@pytest.mark.parametrize("moving", range(1, 16))
def test_the_order_after_many_resets_needs_no_filling_of_each(moving: int) -> None:
    generator = np.random.default_rng(moving)
    for resets in (1, 2, 3, 7, 50):
        objects = int(generator.integers(moving, 64))
        movers = sorted(generator.choice(objects, moving, replace=False).tolist())
        expected = filled_one_by_one(movers, objects, resets)
        assert initial_order._leaf_order(movers, objects, resets) == expected


def test_the_last_reset_takes_no_longer_than_the_first() -> None:
    """10**7 resets took half a minute."""
    iphyre_jax.compile_scene(iphyre_jax.load_scene("hole"), resets=2**31 - 1)

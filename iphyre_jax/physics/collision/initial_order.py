"""What the reference's broad phase looks like before the first step, replayed on the host.

The reference keeps static and moving shapes in two box trees, and every pair of overlapping boxes in linked lists. So
the order of the first contacts depends on how the shapes were inserted. It depends on nothing but the scene and the
number of the reset, so it is computed once, in plain Python and float64:

* the depth-first rank of the static bars in their tree (it never changes, removal included);
* path bits and depth of every moving shape in its tree;
* a counter for every pair: the later the reference inserted a pair, the higher;
* the order in which the moving shapes are visited (a chained hash table's order).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from iphyre_jax.physics.constants import FAT_MARGIN, HASH_COEFFICIENT, LEAF_TABLE_SIZES

Box = tuple[float, float, float, float]  # left, top (smaller y), right, bottom, px


def _union(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _area(a: Box) -> float:
    return (a[2] - a[0]) * (a[3] - a[1])


def _proximity(a: Box, b: Box) -> float:
    return abs(a[0] + a[2] - b[0] - b[2]) + abs(a[1] + a[3] - b[1] - b[3])


def _overlap(a: Box, b: Box) -> bool:
    return a[0] <= b[2] and b[0] <= a[2] and a[1] <= b[3] and b[1] <= a[3]


def grown(box: Box) -> Box:
    """Return the fat box of a shape at rest."""
    width, height = (box[2] - box[0]) * FAT_MARGIN, (box[3] - box[1]) * FAT_MARGIN
    return box[0] - width, box[1] - height, box[2] + width, box[3] + height


@dataclass
class _Node:
    box: Box
    leaf: int | None = None
    first: _Node | None = None
    second: _Node | None = None
    parent: _Node | None = None


class _Tree:
    """A box tree that is filled by the reference's greedy rule and read depth first."""

    def __init__(self) -> None:
        self.root: _Node | None = None

    def insert(self, leaf: int, box: Box) -> _Node:
        node = _Node(box, leaf)
        if self.root is None:
            self.root = node
            return node
        at = self.root
        while at.first is not None and at.second is not None:
            at.box = _union(at.box, box)
            cost_first = _area(at.second.box) + _area(_union(at.first.box, box))
            cost_second = _area(at.first.box) + _area(_union(at.second.box, box))
            if cost_first == cost_second:
                cost_first, cost_second = _proximity(at.first.box, box), _proximity(at.second.box, box)
            at = at.second if cost_second < cost_first else at.first
        joined = _Node(_union(box, at.box), None, node, at, at.parent)
        if at.parent is None:
            self.root = joined
        elif at.parent.first is at:
            at.parent.first = joined
        else:
            at.parent.second = joined
        node.parent = at.parent = joined
        return node


def _query(node: _Node | None, box: Box) -> list[int]:
    """List the leaves under `node` whose boxes overlap `box`, depth first."""
    if node is None or not _overlap(node.box, box):
        return []
    return [node.leaf] if node.leaf is not None else _query(node.first, box) + _query(node.second, box)


def _leaves(node: _Node | None, path: tuple[int, ...] = ()) -> list[tuple[int, tuple[int, ...]]]:
    if node is None:
        return []
    if node.leaf is not None:
        return [(node.leaf, path)]
    return _leaves(node.first, (*path, 0)) + _leaves(node.second, (*path, 1))


@dataclass(frozen=True)
class Insertion:
    """The broad phase before the first step; indices are object indices of the scene (blocks, then balls)."""

    static_order: tuple[int, ...]  # static bars by their rank in the static tree
    leaf_order: tuple[int, ...]  # moving bodies as the update visits them
    path: dict[int, int]  # moving body -> path bits, first bit highest, left-aligned to `n_moving - 1` bits
    depth: dict[int, int]  # moving body -> number of path bits in use
    counter: dict[tuple[int, int], int]  # pair of objects (lower index first) -> counter, from 1; absent: never a pair


def replay_insertion(boxes: list[Box], moving: list[bool], resets: int) -> Insertion:
    """Replay the insertion of a scene's shapes in body order into a space at its `resets`-th reset.

    boxes: exact boxes of the objects at the start; moving: whether each moves; resets: 1 for a fresh space.
    """
    statics, movers = _Tree(), _Tree()
    counter: dict[tuple[int, int], int] = {}

    def count(i: int, j: int) -> None:
        counter[min(i, j), max(i, j)] = 1 + len(counter)  # from 1: the highest order key stands for "none"

    for i, box in enumerate(boxes):
        if not moving[i]:
            statics.insert(i, box)
            for j in _query(movers.root, box):
                count(i, j)
            continue
        fat = grown(box)
        node = movers.insert(i, fat)
        for j in _query(statics.root, fat):
            count(i, j)
        while node.parent is not None:
            sibling = node.parent.second if node.parent.first is node else node.parent.first
            for j in _query(sibling, fat):
                count(i, j)
            node = node.parent
    bits = max(sum(moving) - 1, 0)
    paths = dict(_leaves(movers.root))
    return Insertion(
        static_order=tuple(leaf for leaf, _ in _leaves(statics.root)),
        leaf_order=_leaf_order([i for i, m in enumerate(moving) if m], len(boxes), resets),
        path={i: sum(bit << (bits - 1 - level) for level, bit in enumerate(path)) for i, path in paths.items()},
        depth={i: len(path) for i, path in paths.items()},
        counter=counter,
    )


def _leaf_order(movers: list[int], n_objects: int, resets: int) -> tuple[int, ...]:
    """Iterate the chained hash table after `resets` fillings: ids keep counting, the table never shrinks.

    It grows in the first filling only, so those between the first and the last leave nothing behind.
    """
    size = LEAF_TABLE_SIZES[0]
    chains: list[list[int]] = [[] for _ in range(size)]
    for reset in sorted({0, resets - 1}):
        base = reset * n_objects
        chains = [[] for _ in range(size)]
        for entries, i in enumerate(movers, start=1):
            shape_id = base + i
            chains[shape_id % size].insert(0, shape_id)
            if entries >= size:
                size, old = LEAF_TABLE_SIZES[LEAF_TABLE_SIZES.index(size) + 1], chains
                chains = [[] for _ in range(size)]
                for chain in old:
                    for shape_id in chain:
                        chains[shape_id % size].insert(0, shape_id)
    base = (resets - 1) * n_objects
    return tuple(shape_id - base for chain in chains for shape_id in chain)


def point_classes(first_id: int, second_id: int) -> np.ndarray:
    """Return for each of the four contact ids of a pair of bars the lowest id that it cannot be told from, (4,) int.

    Id 2 e + f stands for end e of the bar with shape id `first_id` against end f of the other. The reference identifies
    a point by a symmetric 64-bit hash; equal hashes make it hand both points the same cached impulses.
    """

    def pair_hash(a: int, b: int) -> int:
        return (a * HASH_COEFFICIENT ^ b * HASH_COEFFICIENT) % 2**64

    hashes = [
        pair_hash(pair_hash(first_id, end_first), pair_hash(second_id, end_second))
        for end_first, end_second in ((0, 0), (0, 1), (1, 0), (1, 1))
    ]
    return np.array([hashes.index(value) for value in hashes], np.int32)

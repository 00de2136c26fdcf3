"""Random scenes are valid, of few topologies, and have what they promise."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from iphyre_jax.scenes import load_scene
from iphyre_jax.scenes.build import topology_of
from iphyre_jax.scenes.geometry import Layouts, gaps
from iphyre_jax.scenes.load import SPLITS
from iphyre_jax.scenes.random_scenes import KINDS, STARTS, Start, random_scene


def test_kinds_are_topologies_those_of_the_games_among_them() -> None:
    rng = np.random.default_rng(0)
    found = set()
    for kind in KINDS:
        for start in STARTS:
            topology = topology_of(random_scene(rng, kind, start))
            assert (topology.bars, topology.balls) == (kind.bars, kind.balls)
            assert (topology.pins, topology.springs) == (kind.joints, kind.springs)
            found.add(topology)
    assert len(found) == len(KINDS) == 24
    assert {topology_of(load_scene(game)) for games in SPLITS.values() for game in games} <= found


def test_kinds_have_every_sort_of_link() -> None:
    sorts: set[tuple[str, str]] = set()
    for kind in KINDS:
        names = ["bar"] * kind.bars + ["ball"] * kind.balls + ["static"]  # HELD, -1, is the last
        for sort, pairs in zip(("joint", "spring"), kind.links, strict=True):
            sorts |= {(sort, " ".join(sorted((names[a], names[b])))) for a, b in pairs}
    ends = ("ball ball", "ball bar", "bar bar", "ball static", "bar static")
    assert sorts == {(sort, end) for sort in ("joint", "spring") for end in ends}


@pytest.mark.parametrize("start", STARTS)
def test_starts_are_what_they_are_called(start: Start) -> None:
    rng = np.random.default_rng(1)
    overlapping = touching = mirrored = 0
    objects: Counter[int] = Counter()
    for kind in KINDS * 3:
        scene = random_scene(rng, kind, start)
        links = Counter(i for pair in scene.joints + scene.springs for i in pair)
        assert all(links[i] <= 1 for i in scene.eliminable_blocks)
        objects[scene.n_objects] += 1
        between = gaps(Layouts.of(scene))[0]
        overlapping += bool((between < -1e-6).any())
        touching += bool((np.abs(between) < 1e-9).any())
        moving = scene.balls[:, 0]
        mirrored += sorted(moving.tolist()) == sorted((600 - moving).tolist())
    assert max(objects) == 12
    assert (overlapping > 20) == (start == "overlapping")
    assert (touching > 40) == (start in ("touching", "stacked"))
    assert (mirrored == len(KINDS) * 3) == (start == "symmetric")


def test_a_seed_is_a_scene() -> None:
    one, other = (random_scene(np.random.default_rng(5), KINDS[20], "touching", fast=True) for _ in range(2))
    assert one == other
    assert one.balls[:, 1].min() < 0

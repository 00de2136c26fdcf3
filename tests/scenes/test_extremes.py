"""Scenes at the edges of what is valid compile to finite numbers; `make test-extremes` plays them."""

from __future__ import annotations

import numpy as np
import pytest

from iphyre_jax import Scene
from iphyre_jax.scenes.compile import compile_scene, topology_of
from tests.robustness.extreme_scenes import pairs, piles


@pytest.mark.parametrize("scenes", [pairs(), piles(15)], ids=["pairs", "piles"])
def test_extreme_scenes_are_valid_compile_to_finite_numbers_and_share_a_program(scenes: list[Scene]) -> None:
    assert len({topology_of(scene) for scene in scenes}) == 1
    for scene in scenes:
        _, world = compile_scene(scene)
        for name, value in vars(world).items():
            for part in (value.x, value.y) if hasattr(value, "x") else (value,):
                assert np.isfinite(np.asarray(part, np.float64)).all(), (scene.name, name)


def test_what_has_no_length_is_no_scene() -> None:
    for blocks, balls in (([[[5, 5], [5, 5]]], [[50, 50, 9]]), ([[[5, 5], [9, 9]]], [[50, 50, 0]])):
        with pytest.raises(ValueError, match=r"expected (end points|a radius)[^\n]*at least 0\.001 px[^\n]*$"):
            Scene("none", blocks, balls, [0, 0], [0, 1])

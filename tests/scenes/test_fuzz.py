"""Random valid scenes of every kind of body, joint and contact stay finite, and static bars stay where they are.

A static bar has no state that a step could change but whether it is there (`State.alive`), so what is looked at is that
as many are gone as the plan has removed. `make test` plays a sample, `make fuzz` ten thousand: IPHYRE_JAX_FUZZ=10000.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.scenes import Scene
from parity.fuzz.random_scenes import TEMPLATES, random_scene

STEPS, FPS = 150, 10
SAMPLE = (0, 13)  # templates whose programs the default suite compiles
COUNT = int(os.environ.get("IPHYRE_JAX_FUZZ", "0"))


def scenes_of(template: int, count: int) -> list[Scene]:
    return [random_scene(template + k * len(TEMPLATES)) for k in range(count)]


def plans(scenes: list[Scene], rng: np.random.Generator) -> np.ndarray:
    """Return plans that remove some blocks at random steps."""
    blocks = np.array([len(scene.eliminable_blocks) for scene in scenes])
    goes = (rng.random((len(scenes), 6)) < 0.6) & (np.arange(6) < blocks[:, None])
    return np.where(goes, rng.integers(0, 100, (len(scenes), 6)), -1)


@pytest.mark.parametrize("template", range(len(TEMPLATES)) if COUNT else SAMPLE)
def test_random_scenes_stay_finite(template: int) -> None:
    scenes = scenes_of(template, -(-COUNT // len(TEMPLATES)) or 30)
    plan = plans(scenes, np.random.default_rng(100 + template))
    for dtype in ("float32", "float64") if COUNT else ("float32",):
        played = iphyre_jax.simulate_many(
            scenes, np.arange(len(scenes)), plan, fps=FPS, duration=STEPS / FPS, dtype=dtype
        )
        assert not (played.fault == 2).any(), "a world is no longer finite"
        assert not (played.fault == 1).any(), "a world has more contact points than four times its topology's slots"
        removed = ((plan >= 0) & (plan < played.steps[:, None])).sum(axis=1)
        np.testing.assert_array_equal(played.eliminations, removed)
        print(f"template {template} {dtype}: {len(scenes)} scenes, {played.success.sum()} solved")

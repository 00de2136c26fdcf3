"""Plays for tests: a real scene, and balls that fall as nothing held them."""

from __future__ import annotations

import numpy as np

from iphyre_jax.models.world.plays import EVERY, STAYS
from iphyre_jax.models.world.tables import Plays, scene_tables
from iphyre_jax.scenes import load_scene


def falling(count: int, frames: int = 20) -> Plays:
    """Plays of "support" whose ball falls from other heights and whose blocks are both gone at once."""
    scenes = scene_tables([load_scene("support")])
    time = np.arange(frames) * EVERY  # physics steps, after the first
    state = np.zeros((count, frames, 1, 6), np.float32)
    start = np.asarray(scenes.centre)[0, np.asarray(scenes.mover)[0, 0]]
    state[..., 0, 0] = start[0] + 10.0 * np.arange(count)[:, None] + time / 60 * 7
    state[..., 0, 1] = start[1] + 100 / 3600 * time * (time + 1) / 2
    state[..., 0, 3] = 7.0
    state[..., 0, 4] = 100 / 60 * (time + 1)
    gone = np.full((count, 12), STAYS, np.int32)
    gone[:, :2] = 0
    scene = np.zeros(count, np.int32)
    valid = np.full(count, frames, np.int32)
    return Plays(scenes, scene, state, valid, gone, np.zeros(count, bool), np.full(count, 6 * frames, np.int32))

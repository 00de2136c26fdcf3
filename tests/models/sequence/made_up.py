"""Plays for tests: hand-made, not played."""

from __future__ import annotations

import numpy as np

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.scenes import load_scene

NEVER = float("nan")


def made_up(fps: int = 60, *, poses: bool = False) -> Dataset:
    """Four plays of support and hinder; hinder has three blocks that can go."""
    scenes = tuple(load_scene(name) for name in ("support", "hinder"))
    times = np.full((4, 6), NEVER, np.float32)
    times[0, :2] = 0.5, 2.0  # solved after 4 s
    times[1, :2] = NEVER, 1.0  # fails
    times[2, :3] = 3.0, 1.2, 6.0  # solved after 5 s: the last removal is not made
    game = np.array([0, 0, 1, 1], np.int32)
    steps = np.where(np.isnan(times), -1, np.rint(np.nan_to_num(times) * fps)).astype(np.int16)
    success = np.array([True, False, True, False])
    end = (np.array([4, 15, 5, 15]) * fps).astype(np.int16)
    removals = np.array([2, 1, 2, 0], np.int8)
    movers = max(int(scene.dynamic.sum()) for scene in scenes)
    # What moves is at x = 100 px + its tenth of a second.
    path = np.broadcast_to(np.arange(150)[None, :, None], (4, 150, movers)) + 100.0
    made = np.stack([path, path * 0 + 300, path * 0], axis=-1).astype(np.float32) if poses else None
    return Dataset(scenes, game, times, steps, success, end, removals, np.arange(4, dtype=np.int32), made, {"fps": fps})

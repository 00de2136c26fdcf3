"""Plays for tests: real scenes and plans with made-up outcomes."""

from __future__ import annotations

import numpy as np

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.augmented import padded_random_plans
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import load_scene

GAMES = ("support", "hinder", "hole")


def made_up(count: int, seed: int, *, shuffled: bool = False) -> Dataset:
    """Plays of which those solve that remove their first block before 3.5 s; or, shuffled, any."""
    rng = np.random.default_rng(seed)
    scenes = tuple(load_scene(game) for game in GAMES)
    game = np.repeat(np.arange(len(GAMES), dtype=np.int32), count)
    times = np.concatenate([padded_random_plans(len(scene.eliminable_blocks), count, rng) for scene in scenes])
    success = np.nan_to_num(times[:, 0], nan=9.0) < 3.5
    if shuffled:
        success = rng.permutation(success)
    steps = plan_to_steps(times, 60, "simulate").astype(np.int16)
    end = np.where(success, 300, 900).astype(np.int16)
    removals = ((steps >= 0) & (steps < end[:, None])).sum(axis=1).astype(np.int8)
    draw = np.tile(np.arange(count, dtype=np.int32), len(GAMES))
    entries = [{"scene": name, "draws": 4 * count, "solved": count} for name in GAMES]
    seconds = times.astype(np.float32)
    return Dataset(scenes, game, seconds, steps, success, end, removals, draw, None, {"fps": 60, "scenes": entries})

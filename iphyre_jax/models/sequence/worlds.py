"""Play plans as data sets are played: how they end, and what is seen on the way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.dataset import Dataset
from iphyre_jax.data.labels import PlayProtocol, label_plans, play_poses
from iphyre_jax.data.sequences import tables
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes import Scene

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int32]


@dataclass(frozen=True)
class PlayResults:
    """How B plans ended."""

    reward: Floats
    success: npt.NDArray[np.bool_]
    end_step: Ints


def play(
    scenes: Sequence[Scene],
    game: npt.NDArray[np.integer[Any]],
    steps: npt.NDArray[np.integer[Any]],
    protocol: PlayProtocol,
) -> PlayResults:
    """Play plans of steps (B, 6), each different one once, in float64."""
    unique, inverse = np.unique(np.column_stack([game, steps]), axis=0, return_inverse=True)
    labels = label_plans(scenes, unique[:, 0], unique[:, 1:], protocol).take(inverse)
    reward = episode_reward(labels.success, labels.removals, labels.end_step, protocol.fps)
    return PlayResults(reward, labels.success, np.asarray(labels.end_step, np.int32))


def play_tables(
    scenes: Sequence[Scene],
    game: npt.NDArray[np.integer[Any]],
    steps: npt.NDArray[np.integer[Any]],
    protocol: PlayProtocol,
) -> Floats:
    """(B, 150, 12, 9) px, what an agent sees every 0.1 s before it acts, under plans of steps (B, 6)."""
    played, count = play(scenes, game, steps, protocol), len(game)
    plays = Dataset(
        tuple(scenes),
        game=np.asarray(game, np.int32),
        times=np.full(steps.shape, np.nan, np.float32),
        steps=steps.astype(np.int16),
        success=played.success,
        end_step=played.end_step.astype(np.int16),
        removals=np.zeros(count, np.int8),
        draw=np.zeros(count, np.int32),
        poses=play_poses(scenes, game, steps, protocol),
        manifest={"fps": protocol.fps},
    )
    return tables(plays, official=False)

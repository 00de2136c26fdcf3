"""The reward of an episode: +1000 for success, -10 for each elimination, -1 for each second."""

from __future__ import annotations

import numbers
from typing import Any

import numpy as np
import numpy.typing as npt

SUCCESS_REWARD = 1000.0
ELIMINATION_REWARD = -10.0
SECOND_REWARD = -1.0


def whole_fps(fps: object) -> int:
    """`fps` as an int.

    Raises:
        ValueError: it is not a positive whole number.
    """
    if not isinstance(fps, bool) and isinstance(fps, numbers.Real):
        value = float(fps)
        if value > 0 and value.is_integer():  # False for an infinity or a NaN
            return int(value)
    raise ValueError(f"fps: expected a positive whole number of physics steps a second, got {fps!r}")


def episode_reward(
    success: npt.NDArray[np.bool_],
    eliminations: npt.NDArray[np.integer[Any]],
    steps: npt.NDArray[np.integer[Any]],
    fps: float,
) -> npt.NDArray[np.float64]:
    """(B,) float64 reward = 1000 if solved - 10 x eliminations - seconds played.

    Args:
        success: (B,) bool, every ball fell below y = 600 px in one step.
        eliminations: (B,) int, blocks removed.
        steps: (B,) int, physics steps made, the solving one included.
        fps: physics steps a second.

    Source: the paper's reward; the official code pays it frame by frame.
    """
    seconds = np.asarray(steps, np.float64) / fps
    return (
        SUCCESS_REWARD * np.asarray(success, np.float64)
        + ELIMINATION_REWARD * np.asarray(eliminations, np.float64)
        + SECOND_REWARD * seconds
    )

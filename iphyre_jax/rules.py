"""The rules of the game: its constants, and the reward of an episode.

Source: the paper and the official package 0.2.3, which states them in several places. What belongs to the solver stands
in `physics.constants`.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

SCREEN: Final = 600.0  # px, side of the picture
GOAL_Y: Final = 600.0  # px, the lower edge: solved once every ball's centre is strictly below it (y > 600) in one step
TIME_LIMIT: Final = 15.0  # s, of an episode, in both official drivers
DECISIONS_PER_SECOND: Final = 10  # the environments look every 0.1 s
FRAMES: Final = 150  # decisions of 0.1 s in an episode
NEVER: Final = -1  # in a plan of steps: the block stays

OFFICIAL_FPS: Final = 10  # physics steps a second of the official environments
PEOPLE_FPS: Final = 60  # physics steps a second of people in the paper, and of the official data sets
OFFICIAL_RESETS: Final = 2  # they build their space, clear it and build it again before the first episode

SUCCESS_REWARD: Final = 1000.0
ELIMINATION_REWARD: Final = -10.0
SECOND_REWARD: Final = -1.0


def episode_reward(
    success: npt.NDArray[np.bool_],
    eliminations: npt.NDArray[np.integer[Any]],
    steps: npt.NDArray[np.integer[Any]],
    fps: float,
) -> npt.NDArray[np.float64]:
    """(B,) float64 reward = 1000 if solved - 10 x eliminations - seconds played.

    Args:
        success: (B,) bool, every ball was below y = 600 px after one and the same step.
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

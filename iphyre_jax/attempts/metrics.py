"""Measures of attempts: the share of games solved within k, and its area AUCCESS.

Shapes: G games, R runs of k attempts each.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_whole

Floats = npt.NDArray[np.float64]


def solved_curve(success: npt.NDArray[np.bool_]) -> Floats:
    """Return the share of runs that have solved each game within 1, 2, ..., k attempts, (G, k).

    Args:
        success: (G, R, k) bool, whether an attempt solved the game.
    """
    return np.logical_or.accumulate(success, axis=2).mean(axis=1)


def solved_curve_of_independent(solved: npt.ArrayLike, played: int, k: int) -> Floats:
    """Return the expected share solved within 1, ..., k attempts if all attempts are draws of one distribution, (G, k).

    The estimate is without bias: 1 - C(n - c, j) / C(n, j) for c of n plays that solved the game, which is the chance
    that j of the n plays, drawn without putting back, hold a success.

    Args:
        solved: (G,) plays of each game that solved it.
        played: plays of each game, at least k.
        k: attempts.

    Raises:
        ValueError: fewer plays than attempts, or than solved ones; one line.
    """
    check_whole("played", played, check_whole("k", k))
    counts = np.asarray(solved, np.float64)
    for count in counts[(counts < 0) | (counts > played)].tolist():
        raise ValueError(f"solved: expected 0 to {played} plays, got {count:g}")
    failed = played - counts[:, None]
    drawn = np.arange(k)  # attempt j + 1 fails, if j failed, with probability (failed - j) / (played - j)
    unsolved = np.cumprod(np.maximum(failed - drawn, 0) / (played - drawn), axis=1)
    return np.asarray(1 - unsolved, np.float64)


def auccess(curve: npt.ArrayLike) -> Floats:
    """Return AUCCESS@k, (...), of the shares solved within 1, ..., k attempts, (..., k).

    The weights are those of PHYRE: ln(j + 1) - ln j for j attempts, divided by their sum.
    """
    shares = np.asarray(curve, np.float64)
    weights = np.diff(np.log(np.arange(1, shares.shape[-1] + 2)))
    return np.asarray(shares @ (weights / weights.sum()), np.float64)


def best_reward(reward: Floats) -> Floats:
    """Return the best reward within 1, ..., k attempts, mean over runs, (G, k), of rewards (G, R, k)."""
    return np.asarray(np.maximum.accumulate(reward, axis=2).mean(axis=1), np.float64)

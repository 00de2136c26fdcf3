"""Do people see as a simulator that is wrong by sigma px? Sigma is fitted on half of the games, tested on the other.

The intuitive-physics-engine account: people imagine a few plans in a noisy simulation of the scene and try the best
one. A planner's score in a game, best of five attempts, is compared with that of people. The rival knows no physics: a
line through the share of random plans that solve a game.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.figures import spearman
from iphyre_jax.intervals import LEVEL, Estimate
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.scenes.library import PAPER_SPLITS

HALVES: Final = 200  # random halves of the games, five of each split
_SEED: Final = 0

Floats = npt.NDArray[np.float64]
Setting = tuple[float, int]  # sigma, px, and the number of drawn plans


@dataclass(frozen=True)
class Test:
    """How well scores of people are foretold in games that were not fitted to, over HALVES.

    Attributes:
        rank: Spearman's correlation.
        error: root mean square, points.
    """

    rank: Estimate
    error: Estimate


@dataclass(frozen=True)
class Fit:
    """The planner against its rival.

    Attributes:
        chosen: how often each setting fitted best.
        planner: the fitted planner.
        rival: the line through the share of random plans that solve a game.
        better_rank: share of halves in which the planner's correlation is the higher one.
        better_error: share of halves in which its error is the smaller one.
    """

    chosen: Mapping[Setting, int]
    planner: Test
    rival: Test
    better_rank: float
    better_error: float


def fit(
    people: Mapping[str, float], planners: Mapping[Setting, Mapping[str, float]], rival: Mapping[str, float]
) -> Fit:
    """Fit the setting on half of the games and test it on the other half, again and again.

    Args:
        people: points in each game.
        planners: points in each game, by setting.
        rival: share of random plans that solve each game.
    """
    wanted, shares = _column(people), _column(rival)
    foretold = np.array([_column(scores) for scores in planners.values()])
    settings = list(planners)
    chosen = dict.fromkeys(settings, 0)
    found: list[tuple[float, ...]] = []
    rng = np.random.default_rng(_SEED)
    for _ in range(HALVES):
        seen = _half(rng)
        best = int(np.argmin(((foretold[:, seen] - wanted[seen]) ** 2).mean(axis=1)))
        chosen[settings[best]] += 1
        slope, level = np.polyfit(shares[seen], wanted[seen], 1)
        line = slope * shares + level
        other = ~seen
        found.append(
            (
                float(spearman(foretold[best, other], wanted[other])),
                float(spearman(shares[other], wanted[other])),
                _error(foretold[best, other], wanted[other]),
                _error(line[other], wanted[other]),
            )
        )
    rank, rival_rank, error, rival_error = np.array(found).T
    return Fit(
        {setting: count for setting, count in chosen.items() if count},
        Test(_over_halves(rank), _over_halves(error)),
        Test(_over_halves(rival_rank), _over_halves(rival_error)),
        float((rank > rival_rank).mean()),
        float((error < rival_error).mean()),
    )


def _column(values: Mapping[str, float]) -> Floats:
    return np.array([values[game] for game in GAMES], np.float64)


def _half(rng: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Half of the games of each split, as a mask over GAMES."""
    picked: set[str] = set()
    for split in PAPER_SPLITS:
        games: Sequence[str] = SPLITS[split]
        picked |= {games[index] for index in rng.permutation(len(games))[: len(games) // 2]}
    return np.array([game in picked for game in GAMES])


def _error(foretold: Floats, wanted: Floats) -> float:
    return float(np.sqrt(((foretold - wanted) ** 2).mean()))


def _over_halves(values: Floats) -> Estimate:
    """The mean over halves, with the range of LEVEL of them: the halves share games, so this is no test."""
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return Estimate(float(values.mean()), float(low), float(high))

"""How good an outcome classifier is: plain NumPy on labels and chances."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.intervals import mean_interval

BINS: Final = 10  # of a reliability plot

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int32]


class Scores(NamedTuple):
    """Measures of N judged plans; shares from 0 to 1. What is not defined is nan."""

    accuracy: float
    balanced: float  # mean of the two recalls
    recall_solved: float  # share of the plans that solve their scene which are judged so
    recall_failed: float
    auroc: float  # within a game, mean over the games that have both outcomes
    brier: float  # mean squared error of the chance


def scores(game: Integers, label: Bools, chance: Floats) -> Scores:
    """Measure judgements.

    Args:
        game: (N,) index of each plan's scene.
        label: (N,) whether it solves it.
        chance: (N,) judged chance that it does; from 0.5 on the judgement is that it does.
    """
    judged = chance >= 0.5
    solved, failed = _mean(judged[label]), _mean(~judged[~label])
    return Scores(
        accuracy=_mean(judged == label),
        balanced=(solved + failed) / 2,
        recall_solved=solved,
        recall_failed=failed,
        auroc=auroc_within(game, label, chance),
        brier=_mean(np.square(chance - label)),
    )


def _mean(values: Bools | Floats) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def auroc(label: Bools, chance: Floats) -> float:
    """The chance that a plan that solves is judged better than one that fails, ties counting half; nan if one lacks."""
    from scipy import stats  # loads slowly, and every command imports this module

    solved, failed = int(label.sum()), int((~label).sum())
    if not solved or not failed:
        return float("nan")
    ranks = stats.rankdata(chance)
    return float((ranks[label].sum() - solved * (solved + 1) / 2) / (solved * failed))


def auroc_within(game: Integers, label: Bools, chance: Floats) -> float:
    """Mean of `auroc` over games. Over all at once it would reward knowing which game is easy."""
    each = [auroc(label[game == one], chance[game == one]) for one in np.unique(game)]
    return _mean(np.array([value for value in each if not np.isnan(value)]))


def accuracy_by_game(game: Integers, label: Bools, chance: Floats, games: int) -> Floats:
    """The accuracy in each of some games, (G,); nan where there is no plan."""
    right = (chance >= 0.5) == label
    return np.array([_mean(right[game == one]) for one in range(games)])


class Reliability(NamedTuple):
    """Judged chances in bins, beside what came true."""

    plans: Integers  # (BINS,) how many
    chance: Floats  # mean judged chance, nan for an empty bin
    solved: Floats  # share solved


def reliability(label: Bools, chance: Floats) -> Reliability:
    """Put judgements into BINS equal bins of their chance."""
    which = np.minimum((chance * BINS).astype(int), BINS - 1)
    pairs = [(_mean(chance[which == one]), _mean(label[which == one])) for one in range(BINS)]
    means, shares = np.array(pairs).T
    return Reliability(np.bincount(which, minlength=BINS).astype(np.int32), means, shares)


def natural_accuracy(game: Integers, label: Bools, chance: Floats, rates: Floats) -> tuple[float, float]:
    """Accuracy if plans solved each game as often as random ones do, and that of the better constant judgement.

    Args:
        game: (N,) index of each plan's scene.
        label: (N,) whether it solves it.
        chance: (N,) judged chance, for plans as frequent as random ones.
        rates: (G,) share of random plans that solve each game.

    Returns:
        Means over the games that have both outcomes.
    """
    found = []
    for one in np.unique(game):
        here = game == one
        part = scores(game[here], label[here], chance[here])
        found.append((rates[one] * part.recall_solved + (1 - rates[one]) * part.recall_failed, rates[one]))
    pairs = [(value, max(rate, 1 - rate)) for value, rate in found if not np.isnan(value)]
    accuracy, constant = np.mean(pairs, axis=0) if pairs else (float("nan"), float("nan"))
    return float(accuracy), float(constant)


def at_rate(chance: Floats, rate: float) -> Floats:
    """Chances judged where half of all plans solve, for plans of which a share `rate` does."""
    odds = chance / np.maximum(1 - chance, 1e-12) * rate / (1 - rate)
    return np.asarray(odds / (1 + odds))


def games_interval(by_game: Floats) -> tuple[float, float]:
    """95 % bootstrap interval over games of the mean of `by_game` (G,)."""
    values = by_game[~np.isnan(by_game)]
    return mean_interval(values)[1:] if len(values) else (float("nan"), float("nan"))

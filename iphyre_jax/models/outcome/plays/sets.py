"""The plays that rows of the report are trained, chosen and judged on. Judged plans were never learned from."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.console import Console

from iphyre_jax.data import collect
from iphyre_jax.data.dataset import Dataset
from iphyre_jax.models.outcome.plays.augmented import augmented, generated, joined, kept_plays
from iphyre_jax.models.outcome.settings import DataName
from iphyre_jax.scenes import SPLITS

OF_A_KIND: Final = 50  # plans that solve, and that fail, of a game in the paper's data
CHOSEN: Final = 25  # of a kind, of each basic game, by which networks are chosen
MOST_DRAWS: Final = 20_000  # of a game
LARGE: Final = 1000  # of a kind, of each basic game, that `relations` learns beside variations
LARGE_SEED: Final = 1
HELD_SCENES: Final = 20  # one varied or generated scene in so many is held out

TRAINED: Final = "training"
HELD: Final = "held-out basic"
VARIED: Final = "held-out variations"
GENERATED: Final = "held-out generated"
TESTED: Final = ("unseen_basic", "noisy", "compositional", "multi_ball")
COLUMNS: Final = (TRAINED, HELD, VARIED, GENERATED, *TESTED)


@dataclass(frozen=True)
class PlaySets:
    """Plays of the fifty games, by what they are for."""

    official: Dataset  # the first 50 + 50 of each of the fifty games, as in the paper
    later: Dataset  # the next 50 + 50 of each
    choose: Dataset  # further ones of the basic games, to choose networks by


def _kind_number(plays: Dataset) -> npt.NDArray[np.int64]:
    """(N,) the how-many-eth play of its outcome in its game each play is, from 0, in the order of drawing."""
    number = np.zeros(len(plays), np.int64)
    for game in range(len(plays.scenes)):
        for kind in (False, True):
            here = np.flatnonzero((plays.game == game) & (plays.success == kind))
            number[here[np.argsort(plays.draw[here], kind="stable")]] = np.arange(len(here))
    return number


def same_plans(plays: Dataset, others: Dataset) -> npt.NDArray[np.bool_]:
    """(N,) whether each play has the scene and the planned steps, also those after its end, of one of others."""
    known = {(others.scenes[game].name, *steps) for game, steps in zip(others.game, others.steps.tolist(), strict=True)}
    names = [plays.scenes[game].name for game in plays.game]
    return np.array([(name, *steps) in known for name, steps in zip(names, plays.steps.tolist(), strict=True)], bool)


def without(plays: Dataset, *others: Dataset) -> Dataset:
    """Plays whose plans are in none of some other data sets: two-block games repeat themselves."""
    for other in others:
        plays = plays.select(~same_plans(plays, other))
    return plays


def of_games(plays: Dataset, games: Sequence[str]) -> Dataset:
    """The plays of some games."""
    wanted = [index for index, scene in enumerate(plays.scenes) if scene.name in games]
    return plays.select(np.isin(plays.game, wanted))


def compact(plays: Dataset) -> Dataset:
    """The same plays without scenes that none of them has: networks that look at all scenes need not see those."""
    used, game = np.unique(plays.game, return_inverse=True)
    entries = [plays.manifest["scenes"][index] for index in used]
    manifest = {**plays.manifest, "scenes": entries}
    scenes = tuple(plays.scenes[index] for index in used)
    return dataclasses.replace(plays, scenes=scenes, game=game.astype(np.int32), manifest=manifest)


def _kept(folder: Path, name: str, console: Console, games: Sequence[str], count: int, seed: int) -> Dataset:
    """A collected data set, from the folder that keeps it, or collected now."""
    title = f"collecting {name}: {count} + {count} plans of each of {len(games)} games"
    draw = partial(collect, games, successes=count, failures=count, seed=seed, max_draws=MOST_DRAWS)
    return kept_plays(folder, name, title, draw, console)


def play_sets(folder: Path, console: Console) -> PlaySets:
    """The plays of the fifty games; what is missing in the folder is played."""
    drawn = joined([_kept(folder, split, console, games, 2 * OF_A_KIND, 0) for split, games in SPLITS.items()])
    number = _kind_number(drawn)
    official = drawn.select(number < OF_A_KIND)
    later = without(drawn.select(number >= OF_A_KIND), official)
    large = _large(folder, console)
    choose = without(large.select(_kind_number(large) < CHOSEN), official, later)
    return PlaySets(official, later, choose)


def _large(folder: Path, console: Console) -> Dataset:
    return _kept(folder, "large", console, SPLITS["basic"], LARGE, LARGE_SEED)


def natural_rates(plays: Dataset) -> npt.NDArray[np.float64]:
    """(S,) the share of random plans that solve each scene, as it was drawn."""
    entries = plays.manifest["scenes"]
    return np.array([entry["solved"] / max(entry["draws"], 1) for entry in entries])


def learned_plays(sets: PlaySets, data: DataName, folder: Path, console: Console) -> Dataset:
    """The plays that a row learns from.

    Args:
        sets: `play_sets`.
        data: "official"; "large" has variations, "generated" also generated scenes.
        folder: that keeps data sets.
        console: for progress.
    """
    if data == "official":
        return compact(of_games(sets.official, SPLITS["basic"]))
    held_out = (of_games(sets.later, SPLITS["basic"]), sets.choose)
    learned = [without(_large(folder, console), *held_out), joined(augmented(folder, console))]
    if data == "generated":
        learned.append(generated(folder, console))
    return joined([learned[0], *(plays.select(~_held(plays)) for plays in learned[1:])])


def held_out_plays(data: DataName, folder: Path, console: Console) -> dict[str, Dataset]:
    """By column, plays of other scenes that no row learns from; none for official data, which have no other scenes."""
    if data == "official":
        return {}
    others = {VARIED: joined(augmented(folder, console)), GENERATED: generated(folder, console)}
    return {name: plays.select(_held(plays)) for name, plays in others.items()}


def _held(plays: Dataset) -> npt.NDArray[np.bool_]:
    """Which plays are held out: all plans of a scene stay together."""
    return np.asarray(plays.game % HELD_SCENES == 0)


def judged_plays(sets: PlaySets, learned: Dataset, others: Mapping[str, Dataset]) -> dict[str, Dataset]:
    """The plays of each column of the report. Noisy, compositional and multi-ball are the paper's own test plays.

    Args:
        sets: `play_sets`.
        learned: plays that were learned from.
        others: by column, plays of other scenes that were not.
    """
    tested = {split: of_games(sets.official, SPLITS[split]) for split in TESTED}
    return {TRAINED: learned, HELD: of_games(sets.later, SPLITS["basic"]), **others, **tested}

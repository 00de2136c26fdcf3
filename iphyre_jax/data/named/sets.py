"""The named data sets: made once, kept in a cache folder, the same bits for everybody.

official       50 plays that solve it and 50 that do not of each of the forty games: the paper's data
test           the next 50 and 50 of the forty games and of the ten unseen ones; no play of `official`
pairs          50 edge pairs of each of the fifty games; no play of `official` or `test`
basic-large    2000 and 2000 of each basic game, seesaw 500 and 500; no play twice, none of `test` or `pairs`
variations     1000 variations of each basic game, 32 random plans each
graded         100 other variations of each basic game, 128 random plans each, with a level of difficulty
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Final

from iphyre_jax.checks import check_flag, check_option, check_whole, show
from iphyre_jax.data.audit import known_plays
from iphyre_jax.data.collection import gather
from iphyre_jax.data.dataset import Dataset, load_dataset, save_dataset, scene_sum
from iphyre_jax.data.journal import Journal, Report, journal_in
from iphyre_jax.data.labels import PlayProtocol
from iphyre_jax.data.named.pairs import edge_pairs
from iphyre_jax.data.named.varied import varied_plays
from iphyre_jax.data.recipe import Recipe, check_recipe
from iphyre_jax.execution.compilation.cache_folder import default_folder
from iphyre_jax.scenes import GAMES, SPLITS, Scene, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, check_games

SETS_VERSION: Final = 1  # of the definitions here
FOLDER: Final = "datasets"  # in the cache folder
UNSEEN: Final = SPLITS["unseen_basic"]
BASIC: Final = SPLITS["basic"]
FEW_SOLVE: Final = "seesaw"  # of the basic games; one random plan in 45 solves it
MOST_SCALE: Final = 1_000
LARGE_SEED, PAIR_SEED, VARIED_SEED, GRADED_SEED = 1, 2, 1, 2  # official and test share the seed 0
MOST_DRAWS: Final = 100_000  # of a game for basic-large


@dataclass(frozen=True)
class _Sets:
    """The named sets at one rate, and how each is made of the others."""

    folder: Path
    fps: int
    sequences: bool
    scale: int
    only: tuple[str, ...] | None
    report: Report | None

    def load(self, name: str) -> Dataset:
        """Return a set from the folder; make it if it is not there."""
        path = self.folder / f"{self._stem(name)}.npz"
        if path.exists() and path.with_suffix(".json").exists():
            return load_dataset(path)
        self.folder.mkdir(parents=True, exist_ok=True)
        make: Callable[[Journal], Dataset] = getattr(self, "_" + name.replace("-", "_"))
        with journal_in(path.with_suffix(".parts"), self.report) as journal:
            made = make(journal)
            named = {**made.manifest, "name": name, "sets_version": SETS_VERSION, "scale": self.scale}
            save_dataset(replace(made, manifest=named), path)
        return load_dataset(path)

    def _stem(self, name: str) -> str:
        """Return the name of the files; what is not the default goes in as eight digits."""
        other = "" if (self.scale, self.only) == (1, None) else json.dumps([self.scale, self.only])
        digits = f"-{hashlib.sha256(other.encode()).hexdigest()[:8]}" if other else ""
        return f"{name}-{self.fps}fps-v{SETS_VERSION}{'-sequences' if self.sequences else ''}{digits}"

    def _without_sequences(self) -> _Sets:
        return replace(self, sequences=False)

    def _scenes(self, names: Sequence[str]) -> list[Scene]:
        chosen = [name for name in names if self.only is None or name in self.only]
        if not chosen:
            raise ValueError(f"games: expected a game of the set, got {show(self.only)}")
        return [load_scene(name) for name in chosen]

    def _count(self, number: int) -> int:
        return -(-number // self.scale)

    @cached_property
    def _recipe(self) -> Recipe:
        return Recipe(protocol=PlayProtocol.at(self.fps), sequences=self.sequences)

    def _official(self, journal: Journal) -> Dataset:
        scenes, count = self._scenes(GAMES), self._count(50)
        recipe = check_recipe(replace(self._recipe, split="official"), scenes, count, count)
        return gather(scenes, [(count, count)] * len(scenes), recipe, journal)

    def _test(self, journal: Journal) -> Dataset:
        scenes, count = self._scenes(ALL_GAMES), self._count(50)
        recipe = check_recipe(replace(self._recipe, unique=True, split="test"), scenes, count, count)
        starts = {}
        known: dict[str, set[bytes]] = {}
        if any(scene.name in GAMES for scene in scenes):
            official = self._without_sequences().load("official")
            starts = {entry["sha256"]: entry["draws"] for entry in official.manifest["scenes"]}
            known = known_plays(official)
        return gather(
            scenes,
            [(count, count)] * len(scenes),
            recipe,
            journal,
            starts=[starts.get(scene_sum(scene), 0) for scene in scenes],
            known=_of_scenes(known, scenes),
        )

    def _pairs(self, journal: Journal) -> Dataset:
        scenes, count = self._scenes(ALL_GAMES), self._count(50)
        recipe = replace(self._recipe, distribution="pairs", seed=PAIR_SEED, unique=True)
        recipe = replace(recipe, split="test")
        return edge_pairs(scenes, count, recipe, self._known(["official", "test"], scenes), journal)

    def _basic_large(self, journal: Journal) -> Dataset:
        scenes = self._scenes(BASIC)
        counts = [self._count(500 if scene.name == FEW_SOLVE else 2000) for scene in scenes]
        recipe = replace(self._recipe, seed=LARGE_SEED, max_draws=MOST_DRAWS, unique=True)
        recipe = check_recipe(recipe, scenes, max(counts), max(counts))
        known = self._known(["test", "pairs"], scenes)
        return gather(scenes, [(count, count) for count in counts], recipe, journal, known=known)

    def _variations(self, journal: Journal) -> Dataset:
        recipe = replace(self._recipe, distribution="variations", seed=VARIED_SEED)
        return varied_plays(self._scenes(BASIC), self._count(1000), 32, recipe, journal)

    def _graded(self, journal: Journal) -> Dataset:
        recipe = replace(self._recipe, distribution="variations", seed=GRADED_SEED, split="test")
        return varied_plays(self._scenes(BASIC), self._count(100), 128, recipe, journal)

    def _known(self, names: Sequence[str], scenes: Sequence[Scene]) -> list[set[bytes]]:
        """Return the plays of other named sets, scene by scene."""
        known: dict[str, set[bytes]] = {}
        for name in names:
            if name == "official" and all(scene.name in UNSEEN for scene in scenes):
                continue
            for scene, plays in known_plays(self._without_sequences().load(name)).items():
                known.setdefault(scene, set()).update(plays)
        return _of_scenes(known, scenes)


def _of_scenes(known: Mapping[str, set[bytes]], scenes: Sequence[Scene]) -> list[set[bytes]]:
    return [known.get(scene_sum(scene), set()) for scene in scenes]


NAMED_SETS: Final = ("official", "test", "pairs", "basic-large", "variations", "graded")


def named_set(
    name: str,
    *,
    fps: int = 60,
    sequences: bool = False,
    games: Sequence[str] | None = None,
    scale: int = 1,
    folder: str | os.PathLike[str] | None = None,
    report: Report | None = None,
) -> Dataset:
    """Return a named data set. The first call makes it, and the sets it depends on; after a kill it goes on.

    Args:
        name: "official", "test", "pairs", "basic-large", "variations" or "graded"; the module says what they hold.
        fps: physics steps a second. 10: as in the official environment for agents that plan ahead, which rounds to
            0.1 s and plays in the second reset. Sets of different rates must not be mixed.
        sequences: whether it has the poses of what moves.
        games: of the set; None for all. With some, plans of "pairs", "variations" and "graded" are other ones than in
            the whole set, and what is said of shared plays holds for sets of the same `games` and `scale`.
        scale: divides the numbers of plays, for trials.
        folder: where data sets are kept; by default `datasets` in the cache folder of compiled programs.
        report: called with a line of progress.

    Raises:
        ValueError: one line naming the argument and what was expected, or naming a file that was changed.
        OSError: a file cannot be read or written.
    """
    check_option("name", name, NAMED_SETS)
    check_flag("sequences", sequences)
    scale = check_whole("scale", scale, 1, MOST_SCALE)
    only = None if games is None else tuple(sorted(check_games(games), key=ALL_GAMES.index))
    recipe = check_recipe(Recipe(protocol=PlayProtocol.at(fps), sequences=sequences), [load_scene(GAMES[0])], 1, 1)
    return _Sets(_folder(folder), recipe.protocol.fps, sequences, scale, only, report).load(name)


def _folder(folder: str | os.PathLike[str] | None) -> Path:
    if folder is None:
        cache = default_folder()
        if cache is None:
            raise ValueError("folder: expected the path of a folder, because the cache folder is turned off")
        return cache / FOLDER
    if not isinstance(folder, str | os.PathLike) or "\0" in str(folder):
        raise ValueError(f"folder: expected the path of a folder, got {show(folder)}")
    return Path(folder)

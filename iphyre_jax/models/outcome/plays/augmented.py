"""Plays of other scenes to learn from: variations of the basic games, and generated scenes.

A variation is mirrored, shifted, stretched and jittered, and has up to three more blocks at random places, of which
some can be removed. Generated scenes are those that ship. Each scene is played with random plans of the official
distribution, then with neighbours of those that solved it: what they tell is where a solution ends.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from rich.console import Console

from iphyre_jax.attempts import agents
from iphyre_jax.data.collection import build
from iphyre_jax.data.dataset import Dataset, load_dataset, save_dataset, scene_entry
from iphyre_jax.data.generated.pool import SHIPPED, load_generated
from iphyre_jax.data.journal import Journal
from iphyre_jax.data.labels import PlayProtocol, label_plans
from iphyre_jax.data.recipe import Recipe
from iphyre_jax.rules import DECISIONS_PER_SECOND
from iphyre_jax.scenes import MAX_ELIMINABLE, SPLITS, Scene
from iphyre_jax.train.scenes import variations

SCENES: Final = 1200  # variations of each game
PLANS: Final = 24  # random plans of each variation
GENERATED_PLANS: Final = 96  # of each generated scene; under 4 % of them solve a quarter of the scenes
NEIGHBOURS: Final = 8  # on average, plans near solutions of each scene
ADDED: Final = 3  # blocks at most
REMOVABLE: Final = 0.6  # chance that an added block can be removed, if there are slots left
MOVE: Final = 0.5  # s, the most by which a neighbour's times differ
STREAM: Final = 104_729  # seeds of these variations: not those that agents train on
OFFICIAL: Final = PlayProtocol()

Floats = npt.NDArray[np.float64]  # float32 rounds some tenths up: at 60 fps those blocks went a step late


def padded_random_plans(blocks: int, count: int, rng: np.random.Generator) -> Floats:
    """Plans of the official distribution, (count, 6) s; NaN for a block that stays or is not there."""
    plans = np.full((count, MAX_ELIMINABLE), np.nan)
    plans[:, :blocks] = agents.random_plans(rng, blocks, count)
    return plans


def neighbours(plans: Floats, blocks: npt.NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """Plans that differ from others (N, 6) by one or two times, or by one block that stays."""
    tenths = np.rint(rng.uniform(-MOVE, MOVE, plans.shape) * DECISIONS_PER_SECOND) / DECISIONS_PER_SECOND
    moved = np.where(rng.random(plans.shape) < 0.5, plans + tenths, plans)
    column = rng.integers(0, blocks)
    toggled = rng.random(len(plans)) < 0.25
    rows = np.flatnonzero(toggled)
    other = rng.uniform(0.1, 6.9, len(rows))
    stood = np.isnan(moved[rows, column[rows]])
    moved[rows, column[rows]] = np.where(stood, other, np.nan)
    return np.maximum(np.round(moved, 1), 0.1)


def distracted(scene: Scene, own: int, rng: np.random.Generator) -> Scene:
    """A variation some of whose added blocks, those from index `own` on, can be removed."""
    eliminable = np.array(scene.eliminable)
    for block in range(own, scene.n_blocks):
        eliminable[block] = rng.random() < REMOVABLE and eliminable.sum() < MAX_ELIMINABLE
    return dataclasses.replace(scene, eliminable=eliminable)


def scenes_of(game: str, count: int, seed: int) -> tuple[Scene, ...]:
    """Variations of a game, about `count`."""
    rng = np.random.default_rng([STREAM, seed])
    plain = variations(game, count, seed + STREAM, ADDED)
    own = min(scene.n_blocks for scene in plain)
    return tuple(distracted(scene, own, rng) for scene in plain)


def play(
    scenes: Sequence[Scene],
    game: npt.NDArray[np.int32],
    times: Floats,
    draw: npt.NDArray[np.int32],
    protocol: PlayProtocol = OFFICIAL,
) -> Dataset:
    """Play plans in float64 and keep what became of them."""
    recipe = Recipe(distribution="official and neighbours of solutions", protocol=protocol, seed=STREAM)
    labels = label_plans(scenes, game, protocol.steps(times), protocol)
    entries = {"scenes": [scene_entry(scene) for scene in scenes]}
    return build(scenes, game, times, labels.columns(draw), recipe, Journal(), entries)


def collect_game(game: str, *, scenes: int = SCENES, plans: int = PLANS, seed: int = 0) -> Dataset:
    """Play variations of a game with random plans and with neighbours of the solutions found."""
    return collect_scenes(scenes_of(game, scenes, seed), plans, seed=seed)


def collect_scenes(
    varied: Sequence[Scene],
    plans: int,
    near: int = NEIGHBOURS,
    seed: int = 0,
    protocol: PlayProtocol = OFFICIAL,
    draw: Callable[[int, int, np.random.Generator], Floats] = padded_random_plans,
) -> Dataset:
    """Play scenes with random plans and with neighbours of the solutions found.

    Args:
        varied: the scenes.
        plans: random plans of each.
        near: neighbours, on average.
        seed: of the plans.
        protocol: rate, rule and reset of the plays.
        draw: gives random plans (count, 6), s, of a scene with so many blocks.
    """
    rng = np.random.default_rng([STREAM, seed, 1])
    blocks = np.array([len(scene.eliminable_blocks) for scene in varied])
    which = np.repeat(np.arange(len(varied), dtype=np.int32), plans)
    times = np.concatenate([draw(int(count), plans, rng) for count in blocks])
    first = play(varied, which, times, np.arange(len(which), dtype=np.int32), protocol)
    solved = np.flatnonzero(first.success)
    if not len(solved) or not near:
        return first
    weight = 1 / np.bincount(which[solved], minlength=len(varied))[which[solved]]  # scenes count alike
    chosen = rng.choice(solved, near * len(varied), p=weight / weight.sum())
    beside = neighbours(times[chosen], blocks[which[chosen]], rng)
    second = play(varied, which[chosen], beside, len(which) + np.arange(len(chosen), dtype=np.int32), protocol)
    return joined([first, second])


def joined(sets: Sequence[Dataset]) -> Dataset:
    """One data set of plays of the same scenes, or of several data sets one after the other."""
    same = all(each.scenes is sets[0].scenes or each.scenes == sets[0].scenes for each in sets)
    offsets = [0] * len(sets) if same else np.cumsum([0, *(len(each.scenes) for each in sets[:-1])]).tolist()
    arrays = {
        name: np.concatenate([each.arrays()[name] for each in sets]) for name in sets[0].arrays() if name != "poses"
    }
    arrays["game"] = np.concatenate(
        [each.game + np.int32(offset) for each, offset in zip(sets, offsets, strict=True)]
    ).astype(np.int32)
    scenes = sets[0].scenes if same else tuple(scene for each in sets for scene in each.scenes)
    entries = [entry for each in (sets[:1] if same else sets) for entry in each.manifest["scenes"]]
    return Dataset(scenes, **arrays, poses=None, manifest={**sets[0].manifest, "scenes": entries})


def augmented(folder: Path, console: Console) -> list[Dataset]:
    """The plays of varied scenes of each basic game, from a folder that keeps them; what is missing is played."""
    return [
        kept_plays(folder, f"augmented-{game}", f"playing variations of {game}", partial(collect_game, game), console)
        for game in SPLITS["basic"]
    ]


def generated(folder: Path, console: Console) -> Dataset:
    """The plays of the generated scenes that ship, from a folder that keeps them, or played now."""

    def collect() -> Dataset:
        return collect_scenes(load_generated(SHIPPED).scenes, GENERATED_PLANS)

    return kept_plays(folder, "generated", "playing generated scenes", collect, console)


def kept_plays(folder: Path, name: str, title: str, collect: Callable[[], Dataset], console: Console) -> Dataset:
    """A data set from the folder that keeps it, or collected now.

    Args:
        folder: of the data sets; made if it is missing.
        name: of the data set.
        title: what is printed if it is collected.
        collect: gives the data set.
        console: for the title.
    """
    file = folder / f"{name}.npz"
    if not (file.is_file() and file.with_suffix(".json").is_file()):
        console.print(title)
        folder.mkdir(parents=True, exist_ok=True)
        save_dataset(collect(), file)
    return load_dataset(file)

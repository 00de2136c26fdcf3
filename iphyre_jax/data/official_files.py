"""Files of the official package: action lists and sequences, read and written without pickles.

GAME/succeed_actions.npy, fail_actions.npy   (n, 9): six times in s, 0 for never or after the end; then solved (1 or
0), blocks removed, seconds played
GAME/0/actions.npy, GAME/0/vectors.npy       clicks (x, y, t) by time, (clicks, 3); tables (150, 12, 9), zeros from
the solution on
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import one_line, show
from iphyre_jax.compat.objects import block_at
from iphyre_jax.data.collection import build
from iphyre_jax.data.dataset import Dataset, scene_entry
from iphyre_jax.data.draws import INTERVAL
from iphyre_jax.data.journal import Journal, Report, journal_in
from iphyre_jax.data.labels import PlayProtocol, label_plans
from iphyre_jax.data.recipe import Recipe, check_poses, check_recipe
from iphyre_jax.data.sequences import rows_by_scene, tables
from iphyre_jax.plans import official_clock
from iphyre_jax.rules import TIME_LIMIT
from iphyre_jax.scenes import Limits, Scene, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, check_names_differ, load_scenes

LISTS: Final = {True: "succeed_actions.npy", False: "fail_actions.npy"}
MAX_BYTES: Final = 200_000_000  # of one file
LONGEST_NAME: Final = 255  # bytes of a folder's name, in usual file systems
_GRID: Final = 1e-5  # s; a float32 time this near to a tenth of a second was drawn as that tenth
_RESULTS: Final = 3  # columns after the times

Floats = npt.NDArray[np.float64]


def drawn_times(dataset: Dataset) -> Floats:
    """Return the times as they were drawn, (N, S) float64, 0 for never: tenths of a second are exact again.

    Of plans in tenths with 0 for never, as all distributions but "policy" draw them, `plan_to_steps` makes the steps
    that were played. NaN of a policy becomes 0, which takes a frame by the rule "simulate"; other times stay rounded.
    """
    times = np.nan_to_num(dataset.times.astype(np.float64))
    tenths = np.rint(times / INTERVAL) * INTERVAL
    return np.where(np.abs(times - tenths) < _GRID, tenths, times)


def action_lists(dataset: Dataset) -> Floats:
    """Return all plays as rows of the official lists, (N, S + 3) float64; times after the end are 0 there.

    That masking tells a learner in principle how a play ends. It happens nowhere else.
    """
    clock = official_clock(dataset.fps)
    seconds = np.append(clock, clock[-1] + 1 / dataset.fps)[dataset.end_step]
    times = drawn_times(dataset)
    times *= times <= seconds[:, None]
    return np.column_stack([times, dataset.success, dataset.removals, seconds])


def check_folder_names(argument: str, scenes: Sequence[Scene]) -> None:
    """Refuse scenes whose names cannot be those of folders beside each other; ValueError, one line."""
    check_names_differ(argument, scenes)
    for scene in scenes:
        plain = Path(scene.name).name == scene.name and scene.name not in ("", ".", "..")
        if not plain or len(os.fsencode(scene.name)) > LONGEST_NAME:
            raise ValueError(f"{argument}: expected names of scenes that can name folders, got {show(scene.name)}")


def check_no_lists(argument: str, folder: Path, scenes: Sequence[Scene]) -> None:
    """Refuse a folder that has one of these scenes' own, for its files would be replaced; ValueError, one line."""
    for scene in scenes:
        if (there := folder / scene.name).exists():
            raise ValueError(f"{argument}: {one_line(str(there))} is there; expected another folder")


def save_official(dataset: Dataset, folder: str | os.PathLike[str]) -> None:
    """Write the action lists of each game, and its sequences if the data set has poses, the solved ones first.

    Whoever plays the lists gives the first frames to the zeros of a row, one each; so a removal there goes some later.
    Sequences keep the times after the end of a play, which the lists set to 0. Games that the folder has besides stay.

    Args:
        dataset: of scenes with different names.
        folder: to write into; files there are replaced.

    Raises:
        ValueError: two scenes have the same name, or one that is no name of a folder; one line.
        OSError: a file cannot be written.
    """
    check_folder_names("dataset", [scene for scene, _ in rows_by_scene(dataset)])
    for scene, rows in rows_by_scene(dataset):
        own, game = dataset.select(rows), Path(folder) / scene.name
        game.mkdir(parents=True, exist_ok=True)
        for solved, name in LISTS.items():
            lists = action_lists(own.select(own.success == solved))
            unused = range(_own_limits(scene).blocks, own.times.shape[1])  # slots for other scenes of the set
            np.save(game / name, np.delete(lists, unused, axis=1))
        for old in _sequence_files(game)[0 if own.poses is None else len(own) :]:
            shutil.rmtree(old.parent)
        if own.poses is not None:
            _save_sequences(scene, own.select(np.argsort(~own.success, kind="stable")), game)


def _own_limits(scene: Scene) -> Limits:
    """Return the limits with which a scene's lists are read again; in a set it has those that cover all scenes."""
    return load_scene(scene.name).limits if scene.name in ALL_GAMES else scene.limits


def _save_sequences(scene: Scene, dataset: Dataset, game: Path) -> None:
    centres = scene.centres[list(scene.eliminable_blocks)]
    for number, (times, table) in enumerate(zip(drawn_times(dataset), tables(dataset), strict=True)):
        clicks = [(*centre, time) for centre, time in zip(centres, times, strict=False) if time]
        folder = game / str(number)
        folder.mkdir(exist_ok=True)
        np.save(folder / "actions.npy", np.array(sorted(clicks, key=lambda click: click[2])).reshape(-1, 3))
        np.save(folder / "vectors.npy", table)


def load_official(
    folder: str | os.PathLike[str],
    *,
    games: Sequence[str] | None = None,
    fps: int = 60,
    sequences: bool = False,
    journal: str | os.PathLike[str] | None = None,
    report: Report | None = None,
    save: Callable[[Dataset], object] | None = None,
) -> Dataset:
    """Read the action lists of a folder, or its sequences where a game has no lists, and play them again.

    The labels are those of a fresh space. `other_labels` of the manifest counts, game by game, the plays that ended
    otherwise when the lists were made, in successive resets.

    Args:
        folder: with a folder for each game.
        games: names; by default all folders that are named as a game.
        fps: physics steps a second of the lists.
        sequences: whether the data set has poses.
        journal: a folder for what is done so far.
        report: called with a line of progress.
        save: called with the data set before the journal goes.

    Raises:
        ValueError: a file holds something else; one line that names it.
        OSError: a file cannot be read.
    """
    if not isinstance(folder, str | os.PathLike) or not Path(folder).is_dir():
        raise ValueError(f"folder: expected a folder with a folder for each game, got {show(folder)}")
    if games is None:
        known = ALL_GAMES
        games = sorted(path.name for path in Path(folder).iterdir() if path.is_dir() and path.name in known)
        if not games:
            raise ValueError(f"folder: expected a folder for a game in {show(str(folder))}, got none")
    scenes = load_scenes([load_scene(name) for name in games])
    recipe = check_recipe(Recipe(protocol=PlayProtocol(fps), sequences=sequences, split="official"), scenes, 0, 0)
    read = [_read_game(Path(folder) / scene.name, scene) for scene in scenes]
    with journal_in(journal, report) as opened:
        dataset = _labelled(scenes, read, recipe, opened)
        if save is not None:
            save(dataset)
        return dataset


def _labelled(
    scenes: Sequence[Scene], read: Sequence[tuple[Floats, Floats]], recipe: Recipe, journal: Journal
) -> Dataset:
    times = np.concatenate([times for times, _ in read])
    check_poses(recipe, scenes, len(times))
    stated = np.concatenate([results for _, results in read])
    game = np.repeat(np.arange(len(scenes)), [len(times) for times, _ in read])
    labels = label_plans(scenes, game, recipe.protocol.steps(times), recipe.protocol, None, journal)
    other = ~np.isnan(stated[:, 0]) & ((stated[:, 0] != labels.success) | (stated[:, 1] != labels.removals))
    draw = np.concatenate([np.arange(len(times)) for times, _ in read])
    entries = [{**scene_entry(scene), "other_labels": int(other[game == k].sum())} for k, scene in enumerate(scenes)]
    manifest = {"source": "official files", "scenes": entries}
    return build(scenes, game, times, labels.columns(draw), recipe, journal, manifest)


def _read_game(game: Path, scene: Scene) -> tuple[Floats, Floats]:
    """Return times, (n, S), 0 for never, and stated results, (n, 3) or NaN."""
    slots = scene.limits.blocks
    lists = [game / name for name in LISTS.values()]
    if all(file.is_file() for file in lists):
        rows = np.concatenate([_read_array(file, slots + _RESULTS) for file in lists])
        return _checked(rows[:, :slots], scene, game), rows[:, slots:]
    times = [_plan_of_clicks(file, scene) for file in _sequence_files(game)]
    if not times:
        raise ValueError(f"{one_line(str(game))}: expected {' and '.join(LISTS.values())}, or sequences 0, 1, ...")
    return _checked(np.array(times), scene, game), np.full((len(times), _RESULTS), np.nan)


def _sequence_files(game: Path) -> list[Path]:
    folders = [path for path in game.iterdir() if path.name.isdecimal()] if game.is_dir() else []
    return [path / "actions.npy" for path in sorted(folders, key=lambda path: int(path.name))]


def _plan_of_clicks(file: Path, scene: Scene) -> Floats:
    """Return the times of a list of clicks; a click that hits nothing, or a block again, is left out."""
    times, alive = np.zeros(scene.limits.blocks), np.ones(scene.n_objects, bool)
    clicks = _read_array(file, 3)
    for x, y, time in clicks[np.argsort(clicks[:, 2], kind="stable")].tolist():
        block = block_at(scene, x, y, alive)
        if block is not None:
            alive[block] = False
            times[scene.eliminable_blocks.index(block)] = time
    return times


def _read_array(file: Path, columns: int) -> Floats:
    """Return the rows of an array file."""
    name = one_line(str(file))
    if (size := file.stat().st_size) > MAX_BYTES:
        raise ValueError(f"{name}: expected at most {MAX_BYTES} bytes, got {size}")
    try:
        array: npt.NDArray[Any] = np.load(file, allow_pickle=False)
    except (ValueError, EOFError, MemoryError) as error:
        raise ValueError(f"{name}: expected an array of numbers: {one_line(str(error))}") from None
    if array.dtype.kind in "biuf" and array.shape == (0,):  # as NumPy writes an empty list
        array = array.reshape(0, columns)
    if array.dtype.kind not in "biuf" or array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"{name}: expected numbers of shape (n, {columns}), got {array.dtype} of shape {array.shape}")
    return array.astype(np.float64)


def _checked(times: Floats, scene: Scene, game: Path) -> Floats:
    if times.size and not ((times >= 0) & (times <= TIME_LIMIT)).all():  # False for NaN
        raise ValueError(f"{one_line(str(game))}: expected times from 0 to {TIME_LIMIT:g} s")
    blocks = len(scene.eliminable_blocks)
    if times[:, blocks:].any():
        raise ValueError(f"{one_line(str(game))}: expected 0 after the times of its {blocks} eliminable blocks")
    return times

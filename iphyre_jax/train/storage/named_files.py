"""Files that the settings of a run name by paths: scene files, a scene pool, a world model. Runs are moved and copied.

A run keeps copies of its scene files, in scenes/PLACE AMONG THE GAMES/, and plays those. Pools and world models can be
large: with relative paths they are looked for in the folders above the run too. Sums tell whether a file is the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from iphyre_jax.data.dataset import scene_sum
from iphyre_jax.data.generated import generated_file
from iphyre_jax.data.generated.pool import SHIPPED
from iphyre_jax.files import replace_bytes
from iphyre_jax.scenes import load_scene
from iphyre_jax.scenes.library import ALL_GAMES
from iphyre_jax.train.settings.run import TrainConfig

FOLDER: Final = "scenes"  # of the copies


def with_whole_paths(config: TrainConfig) -> TrainConfig:
    """Return the settings with whole paths of the scene files among the games, that mean the same anywhere."""
    games = tuple(game if game in ALL_GAMES else str(Path(game).absolute()) for game in config.games)
    return replace(config, games=games)


def scene_sums(config: TrainConfig) -> dict[str, str]:
    """Return the SHA-256 sum of the scene in each scene file among the games.

    Raises:
        ValueError, OSError: one line; a file is missing or wrong.
    """
    return {game: scene_sum(load_scene(game)) for game in config.games if game not in ALL_GAMES}


def copy_scenes(run: Path, config: TrainConfig) -> None:
    """Copy the scene files among the games into the folder of a run, unless they are there.

    Raises:
        OSError: a file cannot be read or written.
    """
    for place, game in enumerate(config.games):
        copy = _copy(run, place, game)
        if game not in ALL_GAMES and not copy.exists():
            copy.parent.mkdir(parents=True, exist_ok=True)
            replace_bytes(copy, Path(game).read_bytes())


def with_own_scenes(run: Path, settings: Any) -> Any:  # noqa: ANN401 - JSON, and the same back
    """Return written settings of a run with the paths of its own copies of scene files, where it has them.

    They are not checked yet: where the files lay first there may be others now, or what this user may not read.
    """
    games = settings.get("games") if isinstance(settings, dict) else None
    if not isinstance(games, list) or not all(isinstance(game, str) for game in games):
        return settings
    return {**settings, "games": [_or_copy(run, place, game) for place, game in enumerate(games)]}


def with_present_files(run: Path, config: TrainConfig) -> TrainConfig:
    """Return the settings of a run with the paths of its pool and its world model where they are now."""
    pool = ",".join(path if path == SHIPPED else _nearest(run, path, _has_pool) for path in config.pool_paths)
    model = config.world_model
    if len(Path(model).parts) > 1:  # else it may be a name in the package
        model = _nearest(run, model, Path.is_dir)
    return replace(config, scene_pool=pool, prediction=model or config.prediction)


def without_paths(config: TrainConfig) -> TrainConfig:
    """Return the settings with the names alone of files that have sums: wherever they lie, those are the same."""
    games = tuple(game if game in ALL_GAMES else Path(game).name for game in config.games)
    pool = tuple(Path(path).name if config.pool_sha256 else path for path in config.pool_paths)
    model = Path(config.prediction).name if config.prediction_sha256 else config.prediction
    return replace(config, games=games, scene_pool=",".join(pool), prediction=model)


def _copy(run: Path, place: int, game: str) -> Path:
    return run / FOLDER / str(place) / Path(game).name


def _or_copy(run: Path, place: int, game: str) -> str:
    copy = _copy(run, place, game)
    return str(copy.absolute()) if game not in ALL_GAMES and _is_there(copy) else game


def _nearest(run: Path, path: str, there: Callable[[Path], bool]) -> str:
    """A relative path as it is if the file is there; else in the nearest folder above the run that has it, if any."""
    if Path(path).is_absolute() or _is_there(path, there):
        return path
    above = (folder / path for folder in (*run.absolute().parents, *run.resolve().parents))
    found = (str(file) for file in above if _is_there(file, there))
    return next((file for file in found if "," not in file), path)  # commas stand between the files of a pool


def _is_there(path: str | Path, there: Callable[[Path], bool] = Path.is_file) -> bool:
    try:
        return there(Path(path))
    except (OSError, ValueError):  # no path at all: too long, or with a null byte
        return False


def _has_pool(path: Path) -> bool:
    return generated_file(path).is_file()

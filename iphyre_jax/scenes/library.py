"""The games of the package, and `load_scene`, which loads every kind of scene."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Final, cast

from iphyre_jax.checks import check_option, is_list, show
from iphyre_jax.files import parse_json
from iphyre_jax.scenes.codec import check_object, scene_from_fields
from iphyre_jax.scenes.files import read_scene
from iphyre_jax.scenes.limits import Limits, check_limits
from iphyre_jax.scenes.scene import Scene

LIBRARY_SCHEMA: Final = "iphyre_jax/scenes"
LIBRARY_VERSION: Final = 1

_LIBRARY: Final = "games.json"
_LIBRARY_FIELDS: Final = ("schema", "version", "source", "conventions", "splits", "games")


@cache
def _read_library() -> Mapping[str, object]:
    """Read the data file of the package, once."""
    content = files(__package__).joinpath(_LIBRARY).read_bytes()
    return check_object(parse_json(content, _LIBRARY), _LIBRARY, LIBRARY_SCHEMA, LIBRARY_VERSION, _LIBRARY_FIELDS)


def _read_splits() -> Mapping[str, tuple[str, ...]]:
    splits = cast(Mapping[str, list[str]], _read_library()["splits"])
    return MappingProxyType({split: tuple(games) for split, games in splits.items()})


SPLITS: Final = _read_splits()
"""Names of the games by split, in the order of the paper. The forty games do not include unseen_basic."""

PAPER_SPLITS: Final = tuple(split for split in SPLITS if split != "unseen_basic")
"""The splits of the paper's tables, which have its forty games."""

GAMES: Final = tuple(game for split in PAPER_SPLITS for game in SPLITS[split])
"""Names of the forty games, split by split."""

GAME_LISTS: Final = MappingProxyType({**SPLITS, "all": GAMES})
"""Names of games by what users call them: a split, or all forty."""

SceneLike = str | os.PathLike[str] | Scene
"""The name of a game, the path of a scene file, or a scene."""

ALL_GAMES: Final = tuple(game for games in SPLITS.values() for game in games)
"""Names of the forty games and of the ten unseen basic ones."""

SPLIT_OF: Final = MappingProxyType({game: split for split, games in SPLITS.items() for game in games})
"""The split of each of them."""


@cache
def _package_game(name: str) -> Scene:
    """Build a game of the package, once. Scenes are immutable, so all callers can share it."""
    games = cast(Mapping[str, Mapping[str, object]], _read_library()["games"])
    return scene_from_fields({"name": name, **games[name]}, f"{_LIBRARY}: {name}")


def is_game(scene: Scene) -> bool:
    """Return whether a scene is a game of the package, not another one of that name."""
    return scene.name in ALL_GAMES and scene == _package_game(scene.name)


def load_scene(scene: SceneLike, limits: Limits | None = None) -> Scene:
    """Load a game of the package or a scene file.

    Args:
        scene: the name of a game (of GAMES or of the split unseen_basic), the path of a scene file, or a Scene, which
            is returned unchanged. A text that is not a game's name is a path if it ends in ".json", contains a path
            separator, or names an existing file or folder.
        limits: of the scene; they replace its own. They decide the shape of its observations and plans.

    Returns:
        The valid scene.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: the file cannot be read.
        ValueError: there is no such game, or the file is wrong; one line for each wrong field.
    """
    if limits is not None:
        check_limits(limits)
    if isinstance(scene, str) and scene in ALL_GAMES:
        scene = _package_game(scene)
    if isinstance(scene, Scene):
        return scene if limits in (None, scene.limits) else replace(scene, limits=limits)
    if isinstance(scene, str) and not looks_like_path(scene):
        raise ValueError(_unknown_game(scene))
    if isinstance(scene, str) or (isinstance(scene, os.PathLike) and isinstance(os.fspath(scene), str)):
        return read_scene(scene, limits)
    raise ValueError(f"scene: expected a game's name, the path of a scene file or a Scene, got {show(scene)}")


def load_scenes(scenes: object, limits: Limits | None = None) -> tuple[Scene, ...]:
    """Load several scenes and give all of them the same limits.

    Args:
        scenes: a sequence of at least one name, file or Scene, as `load_scene` takes them.
        limits: of all scenes; by default the smallest that cover the limits of each.

    Raises:
        ValueError: `scenes` is not a sequence, is empty, or `load_scene` refuses an entry; one line for each problem.
        OSError: a scene file cannot be read.
    """
    if isinstance(scenes, str | os.PathLike | Scene) or not isinstance(scenes, Sequence) or not scenes:
        raise ValueError("scenes: expected a sequence of at least one name, file or Scene")
    loaded = [load_scene(scene, limits) for scene in scenes]
    common = Limits.covering(scene.limits for scene in loaded)
    return tuple(load_scene(scene, common) for scene in loaded)


def load_own_scenes(scenes: Sequence[SceneLike]) -> tuple[Scene, ...]:
    """Load those scenes that are no games of the package, each once; a file may hold a game. Errors as `load_scene`."""
    return tuple(scene for scene in dict.fromkeys(map(load_scene, scenes)) if not is_game(scene))


def check_games(games: object) -> tuple[str, ...]:
    """Return names of games of the package; ValueError in one line for anything else."""
    if not is_list(games):
        raise ValueError(f"games: expected a sequence of names of games, got {show(games)}")
    return tuple(check_option("games", game, ALL_GAMES) for game in cast(Sequence[str], games))


def check_names_differ(argument: str, scenes: Sequence[Scene]) -> None:
    """Refuse scenes of one name, whose scores could not be told apart: ValueError, one line."""
    repeated = [name for name, count in Counter(scene.name for scene in scenes).items() if count > 1]
    if repeated:
        raise ValueError(f"{argument}: expected scenes of different names, got {show(repeated[0])} twice")


def looks_like_path(text: str) -> bool:
    """Return whether a text that may be the name of a game is meant as the path of a file."""
    if text.endswith(".json") or "/" in text or os.sep in text:
        return True
    try:
        return Path(text).exists() and text != ""
    except (OSError, ValueError):  # too long, or with a null byte
        return False


def _unknown_game(name: str) -> str:
    return f"scene: expected the name of a game or the path of a scene file, got {show(name)} ({hint(name)})"


def hint(name: str) -> str:
    """Return a hint for who has misspelled the name of a game."""
    close = get_close_matches(name[:100], ALL_GAMES, n=3)
    return f"did you mean {' or '.join(close)}?" if close else "iphyre_jax.GAMES lists them"

"""The games of the package, and the one door through which every scene comes in."""

import os
from collections.abc import Mapping
from difflib import get_close_matches
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Final, cast

from iphyre_jax.scenes.convert import check_object, scene_from_fields
from iphyre_jax.scenes.files import parse_json, read_scene
from iphyre_jax.scenes.messages import show
from iphyre_jax.scenes.schema import Scene

LIBRARY_SCHEMA: Final = "iphyre_jax/scenes"
LIBRARY_VERSION: Final = 1

_LIBRARY: Final = "games.json"
_LIBRARY_FIELDS: Final = ("schema", "version", "source", "conventions", "splits", "games")


@cache
def _library() -> Mapping[str, object]:
    """Read the package's data file, once."""
    content = files(__package__).joinpath(_LIBRARY).read_bytes()
    return check_object(parse_json(content, _LIBRARY), _LIBRARY, LIBRARY_SCHEMA, LIBRARY_VERSION, _LIBRARY_FIELDS)


def _splits() -> Mapping[str, tuple[str, ...]]:
    splits = cast(Mapping[str, list[str]], _library()["splits"])
    return MappingProxyType({split: tuple(games) for split, games in splits.items()})


SPLITS: Final = _splits()
"""The names of the games of each split, in the paper's order; unseen_basic is no part of the forty."""

GAMES: Final = tuple(game for split, games in SPLITS.items() if split != "unseen_basic" for game in games)
"""The names of the forty games, split by split."""

_ALL_GAMES: Final = tuple(game for games in SPLITS.values() for game in games)


@cache
def _game(name: str) -> Scene:
    """Build a game of the package, once; a scene cannot be changed."""
    games = cast(Mapping[str, Mapping[str, object]], _library()["games"])
    return scene_from_fields({"name": name, **games[name]}, f"{_LIBRARY}: {name}")


def load_scene(scene: str | os.PathLike[str] | Scene) -> Scene:
    """Load a game of the package or a scene file.

    Args:
        scene: the name of a game (of GAMES, or of the split unseen_basic), the path of a scene file, or a Scene, which
            is returned as it is. A text is taken for a path if it is no game's name and ends in ".json", contains a
            separator of folders, or names something that exists.

    Returns:
        The scene, valid.

    Raises:
        FileNotFoundError: there is no such file.
        OSError: the file cannot be read.
        ValueError: there is no such game, or fields of the file are wrong; one line for each.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, str):
        if scene in _ALL_GAMES:
            return _game(scene)
        if not _looks_like_path(scene):
            raise ValueError(_unknown_game(scene))
        return read_scene(scene)
    if isinstance(scene, os.PathLike) and isinstance(os.fspath(scene), str):
        return read_scene(scene)
    raise ValueError(f"scene: expected a game's name, the path of a scene file or a Scene, got {show(scene)}")


def _looks_like_path(text: str) -> bool:
    if text.endswith(".json") or "/" in text or os.sep in text:
        return True
    try:
        return Path(text).exists() and text != ""
    except (OSError, ValueError):  # too long, or with a null byte
        return False


def _unknown_game(name: str) -> str:
    close = get_close_matches(name[:100], _ALL_GAMES, n=3)
    hint = f"did you mean {' or '.join(close)}?" if close else "iphyre_jax.GAMES lists them"
    return f"scene: expected the name of a game or the path of a scene file, got {show(name)} ({hint})"

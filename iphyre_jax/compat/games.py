"""The games by the names of the official package."""

from __future__ import annotations

import os
from copy import deepcopy
from typing import Any, Final

import numpy as np

from iphyre_jax.scenes import GAMES as _GAMES
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, SPLITS, Scene, load_scene, scene_to_dict
from iphyre_jax.scenes.codec import scene_from_fields

GAMES: Final = list(_GAMES)
MAX_OBJ_NUM: Final = MAX_OBJECTS
MAX_ELI_OBJ_NUM: Final = MAX_ELIMINABLE


def _parameters(game: str) -> dict[str, Any]:
    """Return block, ball, eli and dynamic of a game, and joint and spring if it has any."""
    fields = scene_to_dict(load_scene(game))
    optional = [key for key in ("joint", "spring") if fields[key]]
    return {key: fields[key] for key in ("block", "ball", "eli", "dynamic", *optional)}


PARAS: Final = {game: _parameters(game) for games in SPLITS.values() for game in games}
_SHIPPED: Final = deepcopy(PARAS)


def _plain(value: object) -> object:
    """Return arrays as lists, in lists too."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_plain(part) for part in value] if isinstance(value, list) else value


def scene_of(game: str | os.PathLike[str] | Scene) -> Scene:
    """Return the scene of a game: what `PARAS` says, which users may add to or change, else as `load_scene` does.

    Raises:
        ValueError: no such game, or its parameters are wrong; one line for each.
        OSError: a scene file cannot be read.
    """
    if not isinstance(game, str) or game not in PARAS:
        return load_scene(game)
    fields = {key: _plain(value) for key, value in PARAS[game].items()}
    if fields == _SHIPPED.get(game):
        return load_scene(game)
    return scene_from_fields({"name": game, **fields}, f"PARAS[{game!r}]")

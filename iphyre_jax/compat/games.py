"""The games by the names of the official package."""

from __future__ import annotations

from typing import Any, Final

from iphyre_jax.scenes import GAMES as _GAMES
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, SPLITS, load_scene, scene_to_dict

GAMES: Final = list(_GAMES)
MAX_OBJ_NUM: Final = MAX_OBJECTS
MAX_ELI_OBJ_NUM: Final = MAX_ELIMINABLE


def _parameters(game: str) -> dict[str, Any]:
    """Return block, ball, eli and dynamic of a game, and joint and spring if it has any."""
    fields = scene_to_dict(load_scene(game))
    optional = [key for key in ("joint", "spring") if fields[key]]
    return {key: fields[key] for key in ("block", "ball", "eli", "dynamic", *optional)}


PARAS: Final = {game: _parameters(game) for games in SPLITS.values() for game in games}

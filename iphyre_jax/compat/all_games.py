"""The calls of the official `iphyre.utils` that go through all games."""

from __future__ import annotations

from typing import NoReturn

from iphyre_jax.compat.games import GAMES
from iphyre_jax.compat.simulator import IPHYRE, no_window


def collect_initial_all(save_path: str = "./dataset/game_initial_data/", images: bool = True) -> None:
    """Save the start of every game of `GAMES`; see `iphyre_jax.compat.data.save_start`."""
    for game in GAMES:
        IPHYRE(game).collect_initial_data(save_path, images)


def play_all() -> NoReturn:
    """Raise NotImplementedError: the official function opens a window for each game."""
    raise no_window("play_all", "the command iphyre-jax play")


def collect_play_all(player_name: str, max_episode: int, save_path: str) -> NoReturn:
    """Raise NotImplementedError: the official function opens a window for each game."""
    raise no_window("collect_play_all", "the command iphyre-jax play")

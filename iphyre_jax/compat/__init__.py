"""The calls of the official package iphyre 0.2.3 over this solver, without pymunk and pygame.

Replace `from iphyre.simulator import IPHYRE`, `from iphyre.games import GAMES, PARAS, MAX_OBJ_NUM, MAX_ELI_OBJ_NUM` and
`from iphyre.utils import generate_actions, collect_initial_all` by imports of the same names from here. Games that are
added to `PARAS` are games. The physics is float64 and follows the official one reset by reset. Calls that open a window
(`play`, `simulate_vis`, `collect_while_play`, `play_all`, `collect_play_all`) raise NotImplementedError and name a call
without a window.
"""

from iphyre_jax.compat.actions import generate_actions
from iphyre_jax.compat.all_games import collect_initial_all, collect_play_all, play_all
from iphyre_jax.compat.games import GAMES, MAX_ELI_OBJ_NUM, MAX_OBJ_NUM, PARAS
from iphyre_jax.compat.simulator import IPHYRE

__all__ = [
    "GAMES",
    "IPHYRE",
    "MAX_ELI_OBJ_NUM",
    "MAX_OBJ_NUM",
    "PARAS",
    "collect_initial_all",
    "collect_play_all",
    "generate_actions",
    "play_all",
]

"""The calls of the official package iphyre 0.2.3 over this solver, without pymunk and pygame.

In place of `from iphyre.simulator import IPHYRE`, `from iphyre.games import GAMES, PARAS, MAX_OBJ_NUM, MAX_ELI_OBJ_NUM`
and `from iphyre.utils import generate_actions`, import the same names from here. The physics is float64 and follows the
official one reset for reset. What opens a window (`play`, `simulate_vis`, `collect_while_play`) raises
NotImplementedError and says what does the same without one.
"""

from iphyre_jax.compat.actions import generate_actions
from iphyre_jax.compat.games import GAMES, MAX_ELI_OBJ_NUM, MAX_OBJ_NUM, PARAS
from iphyre_jax.compat.simulator import IPHYRE

__all__ = ["GAMES", "IPHYRE", "MAX_ELI_OBJ_NUM", "MAX_OBJ_NUM", "PARAS", "generate_actions"]

"""The step with five values of trainers written for gymnax before 1.0 (purejaxrl, rejax)."""

from __future__ import annotations

from typing import Any

import jax

from iphyre_jax.adapters.gymnax_env import GymnaxView
from iphyre_jax.envs import EnvParams, EnvState


class FiveValues(GymnaxView):
    """An environment whose `step` returns obs, state, reward, done, info.

    done is terminated or truncated; both are in info, by gymnasium's definition. Only if `make` was told so, info also
    has `final_observation`: trainers that keep the infos of a run keep it too. Where gymnax is installed, the spaces
    are its own.

    Attributes:
        env: the environment; those trainers expect autoreset.
        default_params: for `reset` and `step` without parameters; it has `max_steps_in_episode`.
    """

    def step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams | None = None
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, dict[str, Any]]:
        """Play one decision; see `Environment.step`."""
        obs, state, reward, terminated, truncated, info = self._play(key, state, action, params)
        return obs, state, reward, terminated | truncated, info

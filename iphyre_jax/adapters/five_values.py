"""The step with five values of trainers written for gymnax before 1.0 (purejaxrl, rejax)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax

from iphyre_jax.checks import check_instance
from iphyre_jax.envs import Environment, EnvParams, EnvState
from iphyre_jax.envs.spaces import Box, Space


@dataclass(frozen=True, eq=False)
class FiveValues:
    """An environment whose `step` returns obs, state, reward, done, info.

    done is terminated or truncated; both are in info.

    Attributes:
        env: the environment; those trainers expect autoreset.
        default_params: for `reset` and `step` without parameters.

    Raises:
        ValueError: they are not what `make` returns; one line.
    """

    env: Environment
    default_params: EnvParams

    def __post_init__(self) -> None:
        """Check the attributes."""
        check_instance("env", self.env, Environment, "an environment that make has returned")
        check_instance("default_params", self.default_params, EnvParams, "the parameters that make has returned")

    @property
    def name(self) -> str:
        """The id of the environment."""
        return self.env.name

    @property
    def num_actions(self) -> int:
        """Number of actions of a discrete strategy, length of an action of the others."""
        return self.env.num_actions

    def reset(self, key: jax.Array, params: EnvParams | None = None) -> tuple[jax.Array, EnvState]:
        """Begin an episode; see `Environment.reset`."""
        return self.env.reset(key, self.default_params if params is None else params)

    def step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams | None = None
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, dict[str, Any]]:
        """Play one decision; see `Environment.step`."""
        given = self.default_params if params is None else params
        obs, state, reward, terminated, truncated, info = self.env.step(key, state, action, given)
        info = info | {"terminated": terminated, "truncated": truncated}
        return obs, state, reward, terminated | truncated, info

    def action_space(self, params: EnvParams | None = None) -> Space:
        """Return the space of actions."""
        return self.env.action_space(params)

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Return the space of observations."""
        return self.env.observation_space(params)

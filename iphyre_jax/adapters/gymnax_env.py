"""The environments as those of gymnax: its spaces, its parameters, its steps."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any

import jax

from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.checks import check_instance
from iphyre_jax.envs import Discrete, Environment, EnvParams, EnvState
from iphyre_jax.envs.core import Info
from iphyre_jax.envs.spaces import Space


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GymnaxParams(EnvParams):
    """Games, and the length of an episode that trainers look for in the parameters.

    Attributes:
        params: the games.
        max_steps_in_episode: the most decisions of an episode. It follows from the strategy; another number changes
            no rule.
    """

    params: EnvParams
    max_steps_in_episode: int = field(metadata={"static": True})

    def replace(self, **changes: Any) -> GymnaxParams:  # noqa: ANN401
        """Return the parameters with other attributes, as gymnax's own do."""
        return replace(self, **changes)

    @property
    def made_for(self) -> str:  # type: ignore[override]
        """Refuse, in one line, the package's own calls, which ask for it."""
        raise ValueError("params: expected the parameters that make has returned, got gymnax's; use params.params")

    @property
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32."""
        return self.params.topology_id


@dataclass(frozen=True, eq=False)
class GymnaxView:
    """What the adapters of gymnax's trainers share. Where gymnax is installed, the spaces are its own.

    Attributes:
        env: the environment; those trainers expect autoreset.
        default_params: for `reset` and `step` without parameters; a `GymnaxParams`, whatever was given.

    Raises:
        ValueError: they are not what `make` returns; one line.
    """

    env: Environment
    default_params: EnvParams

    def __post_init__(self) -> None:
        """Check the attributes, and add the length of an episode to the parameters."""
        check_instance("env", self.env, Environment, "an environment that make has returned")
        check_instance("default_params", self.default_params, EnvParams, "the parameters that make has returned")
        params = GymnaxParams(games_of(self.default_params), self.env.strategy.decisions)
        object.__setattr__(self, "default_params", params)

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
        return self.env.reset(key, games_of(params or self.default_params))

    def _play(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams | None
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        """Play one decision; see `Environment.step`. Terminated and truncated are gymnasium's, in the info too."""
        given = games_of(params or self.default_params)
        obs, state, reward, *official, info = self.env.step(key, state, action, given)
        terminated, truncated = gymnasium_flags(self.env, *official)
        info = info | {"terminated": terminated, "truncated": truncated}
        return obs, state, reward, terminated, truncated, info

    def action_space(self, params: EnvParams | None = None) -> Any:  # noqa: ANN401 - gymnax's or our own
        """Return the space of actions."""
        return _gymnax_space(self.env.action_space(params))

    def observation_space(self, params: EnvParams | None = None) -> Any:  # noqa: ANN401
        """Return the space of observations."""
        return _gymnax_space(self.env.observation_space(params))


class GymnaxEnv(GymnaxView):
    """An environment with the six values of gymnax from 1.0 on; its wrappers want final_observation=True in `make`."""

    def step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams | None = None
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        """Play one decision; see `Environment.step`. Terminated and truncated are gymnasium's."""
        return self._play(key, state, action, params)


def games_of(params: EnvParams) -> EnvParams:
    """Return the games of parameters, without what trainers want beside them."""
    return params.params if isinstance(params, GymnaxParams) else params


def _gymnax_space(space: Space) -> Any:  # noqa: ANN401
    """Return the space as gymnax's class, which its wrappers and rejax ask for; our own if gymnax is missing."""
    try:
        spaces = import_module("gymnax.environments.spaces")
    except ModuleNotFoundError:
        return space
    if isinstance(space, Discrete):
        return spaces.Discrete(space.n)
    box = spaces.Box(space.low, space.high, space.shape, jax.numpy.dtype(space.dtype))
    box.sample = space.sample  # gymnax's own gives NaN between infinite bounds
    return box

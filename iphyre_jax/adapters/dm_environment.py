"""One world as a `dm_env.Environment`."""

from __future__ import annotations

from typing import Any

import dm_env
import jax
import numpy as np
from dm_env import specs

from iphyre_jax.adapters.arguments import SEEDS, checked_action, checked_seed, refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.envs import Environment, EnvParams, EnvState, make
from iphyre_jax.envs.params import on_device, on_host
from iphyre_jax.envs.spaces import Discrete
from iphyre_jax.execution.forks import check_fork


class DmEnv(dm_env.Environment):
    """One world as a `dm_env.Environment`.

    Every episode is one of the id's games, drawn with the environment's own generator. The discount is 0 where an
    episode ends by itself, which an in-advance one always does, and 1 where time cuts it.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        seed: of the games, 0 to 2**63 - 1, or None for another at each time.
        **options: as for `iphyre_jax.make`, except autoreset and final_observation.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    def __init__(self, id: str, *, seed: int | None = None, **options: Any) -> None:  # noqa: ANN401
        refuse_options(options, ("autoreset", "final_observation"), ", because the interface says when to reset")
        self._random = np.random.default_rng(checked_seed(seed))
        self.env, self.params = make(id, autoreset=False, **options)
        self._x64 = self.env.dtype == "float64"
        self._single: dict[int, tuple[Environment, EnvParams]] = {}  # games played, so that no others compile
        self._game = 0
        self._state: EnvState | None = None  # None: the next step begins an episode

    def reset(self) -> dm_env.TimeStep:
        """Begin an episode."""
        check_fork()
        self._game = int(self._random.integers(SEEDS)) % self.params.n_games
        env, params = self._played()
        with jax.enable_x64(self._x64):
            obs, self._state = env.reset_to(np.int32(0), params)
            return dm_env.restart(np.array(obs))

    def step(self, action: Any) -> dm_env.TimeStep:  # noqa: ANN401 - whatever the user takes for one
        """Play one decision; after the end of an episode, and at first, begin one instead.

        Raises:
            ValueError: the action is not of the action space; one line.
        """
        if self._state is None:
            return self.reset()
        check_fork()
        checked = checked_action(self.env.action_space(), action, ())
        env, params = self._played()
        with jax.enable_x64(self._x64):
            out = env.step(jax.random.key(0), self._state, checked, params)  # without autoreset nothing is random
            obs, self._state, reward = np.array(out[0]), out[1], np.float32(out[2])
            terminated, truncated = gymnasium_flags(self.env, bool(out[3]), bool(out[4]))
        if terminated or truncated:
            self._state = None
        if terminated:
            return dm_env.TimeStep(dm_env.StepType.LAST, reward, np.float32(0.0), obs)
        return (dm_env.truncation if truncated else dm_env.transition)(reward, obs, np.float32(1.0))

    def _played(self) -> tuple[Environment, EnvParams]:
        """Return an environment of the episode's game alone."""
        if self._game not in self._single:
            self._single[self._game] = self.env.single_game(self.params, self._game)
        return self._single[self._game]

    def __getstate__(self) -> dict[str, Any]:
        return on_host(self.__dict__ | {"_single": {}}, ("params", "_state"))

    def __setstate__(self, content: dict[str, Any]) -> None:
        self.__dict__.update(on_device(content, ("params", "_state"), content["_x64"]))

    def observation_spec(self) -> specs.Array:
        """Return the specification of an observation."""
        space = self.env.observation_space()
        if not np.isfinite([space.low, space.high]).all():
            return specs.Array(space.shape, space.dtype, "observation")
        return specs.BoundedArray(space.shape, space.dtype, space.low, space.high, "observation")

    def action_spec(self) -> specs.BoundedArray:
        """Return the specification of an action."""
        space = self.env.action_space()
        if isinstance(space, Discrete):
            return specs.DiscreteArray(space.n, np.int32, "action")
        return specs.BoundedArray(space.shape, space.dtype, space.low, space.high, "action")

    def reward_spec(self) -> specs.Array:
        """Return the specification of a reward."""
        return specs.Array((), np.float32, "reward")

    def discount_spec(self) -> specs.BoundedArray:
        """Return the specification of a discount."""
        return specs.BoundedArray((), np.float32, 0.0, 1.0, "discount")

"""Many worlds as one `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from iphyre_jax.adapters.gymnasium_env import SEEDS, checked_action, checked_seed, gymnasium_flags, space_of
from iphyre_jax.checks import MAX_SEED, check_whole, show
from iphyre_jax.envs import EnvParams, EnvState, make
from iphyre_jax.envs.arguments import check_batch
from iphyre_jax.envs.core import Environment
from iphyre_jax.execution.forks import check_fork

MAX_WORLDS = 1_000_000


class GymnasiumVectorEnv(VectorEnv[npt.NDArray[Any], Any, npt.NDArray[Any]]):
    """B worlds in one program, each like a `GymnasiumEnv` with its own seed; an ended episode resets in the same step.

    `final_obs` and `final_info` have the last observation and info of an ended episode, with the masks `_final_obs` and
    `_final_info`, as in gymnasium's own vector environments with that autoreset mode.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        num_envs: B, the number of worlds, 1 to 1,000,000 if memory allows.
        **options: as for `iphyre_jax.make`, except autoreset and final_observation.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_modes": []}  # noqa: RUF012  # declared so there

    def __init__(self, id: str, num_envs: int = 1, **options: Any) -> None:  # noqa: ANN401
        check_whole("num_envs", num_envs, 1, MAX_WORLDS)
        if "autoreset" in options:
            raise ValueError("autoreset: expected none, because the vector environment always resets in the same step")
        self.num_envs = num_envs
        self.env, self.params = make(id, autoreset=True, final_observation=True, **options)
        check_batch("num_envs", self.env, num_envs)
        self.single_observation_space = space_of(self.env.observation_space())
        self.single_action_space = space_of(self.env.action_space())
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._x64 = self.env.dtype == "float64"
        self._generators = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._seeds = np.zeros(num_envs, np.int64)  # seed of each world's next episode
        self._state: EnvState | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin an episode in every world.

        Args:
            seed: s for the seeds s, s + 1, ..., or one seed for each world, 0 to 2**63 - 1 each, or None to continue
                with the generators.
            options: must be empty.

        Raises:
            ValueError: there are options, or more or fewer seeds than worlds; one line.
        """
        check_fork()
        if options:
            names = ", ".join(map(str, options)) if isinstance(options, dict) else show(options)
            raise ValueError(f"options: expected none, got {names}")
        seeds = [] if seed is None else self._seeds_of(seed)
        for k, one in enumerate(seeds):
            if one is not None:
                self._generators[k] = seeding.np_random(one)[0]
        every = np.ones(self.num_envs, bool)
        self._draw(every)
        with jax.enable_x64(self._x64):
            obs, self._state, info = _reset(self.env, self._seeds, self.params)
        self._draw(every)
        return np.array(obs), self._infos(info, every, np.zeros(self.num_envs, bool), np.zeros(self.num_envs, bool))

    def step(
        self,
        actions: Any,  # noqa: ANN401
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Play one decision in every world.

        Raises:
            ValueError: the actions are not of the action space, or `reset` was not called; one line.
        """
        check_fork()
        if self._state is None:
            raise ValueError("step: expected a call of reset before the first step")
        checked = checked_action(self.env.action_space(), actions, (self.num_envs,))
        with jax.enable_x64(self._x64):
            out = _step(self.env, self._seeds, self._state, checked, self.params)
        obs, self._state, reward, terminated, truncated, last, now = out
        official = np.array(terminated), np.array(truncated)
        done = official[0] | official[1]
        self._draw(done)
        nothing = np.zeros(self.num_envs, bool)
        infos = self._infos(now, np.ones(self.num_envs, bool), official[0] & ~done, official[1] & ~done)
        if done.any():
            infos["final_obs"] = np.array(last["final_observation"])
            infos["_final_obs"] = done.copy()
            infos["final_info"] = self._infos(last, done, *official)
            infos["_final_info"] = done.copy()
        flags = gymnasium_flags(self.env, *official)
        return np.array(obs), np.array(reward, np.float64), flags[0] | nothing, flags[1] | nothing, infos

    def _seeds_of(self, seed: int | Sequence[int | None]) -> list[int | None]:
        """Return the seed of each world; ValueError in one line for anything but numbers and None."""
        if not isinstance(seed, Sequence | np.ndarray):
            first = check_whole("seed", seed, 0, MAX_SEED)
            return [check_whole("seed", first + k, 0, MAX_SEED) for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs}, one for each world, got {len(seed)}")
        return [checked_seed(one) for one in seed]

    def _draw(self, worlds: npt.NDArray[np.bool_]) -> None:
        """Draw the seeds of the next episodes of some worlds, each from the world's own generator."""
        for k in np.flatnonzero(worlds):
            self._seeds[k] = self._generators[k].integers(SEEDS)

    def _infos(
        self,
        info: dict[str, Any],
        present: npt.NDArray[np.bool_],
        terminated: npt.NDArray[np.bool_],
        truncated: npt.NDArray[np.bool_],
    ) -> dict[str, Any]:
        """Return infos as arrays over the worlds, each with the mask of the worlds that have it."""
        arrays = {name: np.array(value) for name, value in info.items() if name != "final_observation"}
        arrays |= {"official_terminated": terminated, "official_truncated": truncated}
        return arrays | {f"_{name}": present.copy() for name in arrays}


def _keys(seeds: jax.Array) -> jax.Array:
    return jax.vmap(jax.random.key)(seeds)


@partial(jax.jit, static_argnums=0)
def _reset(env: Environment, seeds: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState, dict[str, Any]]:
    obs, state = jax.vmap(env.reset, in_axes=(0, None))(_keys(seeds), params)
    return obs, state, jax.vmap(env.info, in_axes=(0, None))(state, params)


@partial(jax.jit, static_argnums=0)
def _step(
    env: Environment, seeds: jax.Array, state: EnvState, actions: jax.Array, params: EnvParams
) -> tuple[Any, ...]:
    out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(_keys(seeds), state, actions, params)
    return *out, jax.vmap(env.info, in_axes=(0, None))(out[1], params)

"""Many worlds as one `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from iphyre_jax.adapters.arguments import SEEDS, as_array, checked_action, checked_seed, refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.adapters.gymnasium_env import (
    RENDER_SIZE,
    check_render_mode,
    game_row,
    space_of,
)
from iphyre_jax.checks import MAX_SEED, check_instance, check_option, check_whole
from iphyre_jax.envs import EnvParams, EnvState, make
from iphyre_jax.envs.arguments import check_batch
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.params import on_device, on_host
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.observations.drawing import draw
from iphyre_jax.observations.images import drawing_of

MAX_WORLDS = 1_000_000
_ANY_GAME = -1
_MODES = {mode.value: mode for mode in AutoresetMode}
_ON_DEVICE = ("params", "_state")
_RESET_OPTIONS = ("game", "reset_mask")


class GymnasiumVectorEnv(VectorEnv[npt.NDArray[Any], Any, npt.NDArray[Any]]):
    """B worlds in one program, each like a `GymnasiumEnv` with its own seed.

    It has the three modes of gymnasium's own vector environments. Same step (the default): an ended episode is followed
    by the next in the same call, and `final_obs` and `final_info` have its last observation and info, with the masks
    `_final_obs` and `_final_info`. Next step: the next call begins one, whatever the action, for a reward of 0.
    Disabled: the user begins it, by `reset(options={"reset_mask": mask})`.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        num_envs: B, the number of worlds, 1 to 1,000,000 if memory allows.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`, or its value, "SameStep", "NextStep" or "Disabled".
        render_mode: "rgb_array" for `render` to return pictures of the worlds, or None.
        **options: as for `iphyre_jax.make`, except autoreset and final_observation.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    metadata = {  # noqa: RUF012  # declared so there
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        id: str,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        render_mode: str | None = None,
        **options: Any,  # noqa: ANN401
    ) -> None:
        num_envs = check_whole("num_envs", num_envs, 1, MAX_WORLDS)
        check_render_mode(render_mode)
        refuse_options(
            options, ("autoreset", "final_observation"), "; say autoreset_mode, one of gymnasium.vector.AutoresetMode"
        )
        chosen = getattr(autoreset_mode, "value", autoreset_mode)
        self._mode = _MODES[check_option("autoreset_mode", chosen, tuple(_MODES))]
        same_step = self._mode == AutoresetMode.SAME_STEP
        self.metadata = self.metadata | {"autoreset_mode": self._mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.env, self.params = make(id, autoreset=same_step, final_observation=same_step, **options)
        check_batch("num_envs", self.env, num_envs)
        self.single_observation_space = space_of(self.env.observation_space())
        self.single_action_space = space_of(self.env.action_space())
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._x64 = self.env.dtype == "float64"
        self._generators = [seeding.np_random(None) for _ in range(num_envs)]  # each with its seed
        self._seeds = np.zeros(num_envs, np.int64)  # seed of each world's next episode
        self._draw(np.ones(num_envs, bool))
        self._ended = np.zeros(num_envs, bool)
        self._obs: npt.NDArray[Any] = np.zeros(self.observation_space.shape or (), self.observation_space.dtype)
        self._state: EnvState | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin an episode in every world, or in some.

        Args:
            seed: s for the seeds s, s + 1, ..., or one seed for each world, 0 to 2**63 - 1 each, or None to continue
                with the generators.
            options: "game", the name or number of the game of these episodes, or a list of B of them; "reset_mask",
                (B,) bool, the worlds that begin an episode, all by default.

        Raises:
            ValueError: an option is unknown or wrong, there are more or fewer seeds than worlds, or worlds are left
                out of the first reset; one line.
        """
        check_fork()
        if options is not None:
            check_instance("options", options, dict, 'a dict such as {"game": "hole"} or None')
        mask, games = self._reset_options(options or {})
        seeds = [] if seed is None else self._seeds_of(seed)
        for k, one in enumerate(seeds):
            if one is not None and mask[k]:
                self._generators[k] = seeding.np_random(one)
                self._seeds[k] = self._generators[k][0].integers(SEEDS)
        info = self._begin(mask, games)
        return self._obs.copy(), self._infos(info, mask, np.zeros_like(mask), np.zeros_like(mask))

    def step(
        self,
        actions: Any,  # noqa: ANN401
    ) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Play one decision in every world.

        Raises:
            ValueError: the actions are not of the action space, `reset` was not called, or a world has ended that only
                the user resets; one line.
        """
        check_fork()
        if self._state is None:
            raise ValueError("step: expected a call of reset before the first step")
        if self._mode == AutoresetMode.DISABLED and self._ended.any():
            ended = int(self._ended.sum())
            raise ValueError(
                f'step: expected a reset with options["reset_mask"] of worlds that ended, got {ended} ended'
            )
        checked = checked_action(self.env.action_space(), actions, (self.num_envs,), self._ended)
        with jax.enable_x64(self._x64):
            out = _step(self.env, self._seeds, self._state, checked, self.params)
        obs, self._state, reward, terminated, truncated, last, now = out
        self._obs, rewards = np.array(obs), np.array(reward, np.float64)
        official = np.array(terminated), np.array(truncated)
        every, nothing = np.ones(self.num_envs, bool), np.zeros(self.num_envs, bool)
        if self._mode == AutoresetMode.SAME_STEP:
            done = official[0] | official[1]
            self._draw(done)
            infos = self._infos(now, every, official[0] & ~done, official[1] & ~done)
            if done.any():
                infos["final_obs"] = np.array(last["final_observation"])
                infos["_final_obs"] = done.copy()
                infos["final_info"] = self._infos(last, done, *official)
                infos["_final_info"] = done.copy()
        else:
            begun = self._ended.copy()  # all False if only the user resets
            if begun.any():  # what these worlds have just played was an episode that had ended: nothing
                now = self._begin(begun, np.full(self.num_envs, _ANY_GAME, np.int32))
                rewards[begun], official = 0.0, (official[0] & ~begun, official[1] & ~begun)
            self._ended = official[0] | official[1]
            infos = self._infos(now, every, *official)
        flags = gymnasium_flags(self.env, *official)
        return self._obs.copy(), rewards, flags[0] | nothing, flags[1] | nothing, infos

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each world, as gymnasium's own vector environments have them."""
        return tuple(generator for generator, _ in self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seed of each world's generator."""
        return tuple(seed for _, seed in self._generators)

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """Return the pictures of the worlds, (600, 600, 3) uint8 each; None without a render mode."""
        if self.render_mode is None or self._state is None:
            return None
        with jax.enable_x64(self._x64):
            return tuple(np.array(_pictures(self.env, self.params, self._state)))

    def _reset_options(self, options: dict[str, Any]) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int32]]:
        """Return the worlds that begin an episode, and the game of each, -1 for any."""
        unknown = [str(name) for name in options if name not in _RESET_OPTIONS]
        if unknown:
            raise ValueError(f"options: expected none but {' and '.join(_RESET_OPTIONS)}, got {', '.join(unknown)}")
        mask = as_array("reset_mask", options.get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(f"options: expected a reset_mask of {self.num_envs} bool, some of them true")
        if self._state is None and not mask.all():
            raise ValueError("options: expected all worlds in the reset_mask of the first reset")
        game = options.get("game")
        if game is None:
            return mask.copy(), np.full(self.num_envs, _ANY_GAME, np.int32)
        several = isinstance(game, list | tuple) or (isinstance(game, np.ndarray) and game.ndim > 0)
        games = list(game) if several else [game] * self.num_envs
        if len(games) != self.num_envs:
            raise ValueError(f"options: expected one game, or {self.num_envs}, got {len(games)}")
        return mask.copy(), np.array([game_row(self.env, one) for one in games], np.int32)

    def _begin(self, worlds: npt.NDArray[np.bool_], games: npt.NDArray[np.int32]) -> dict[str, Any]:
        """Begin an episode in some worlds, and return the infos of all."""
        with jax.enable_x64(self._x64):
            obs, state = _reset(self.env, self._seeds, games, self.params)
            if self._state is not None:
                state = _where(worlds, state, self._state)
            self._obs = np.where(worlds.reshape(-1, *[1] * (obs.ndim - 1)), obs, self._obs)
            self._state, self._ended = state, self._ended & ~worlds
            self._draw(worlds)
            return dict(_info(self.env, state, self.params))

    def _seeds_of(self, seed: Any) -> list[int | None]:  # noqa: ANN401 - of NumPy too
        """Return the seed of each world; ValueError in one line for anything but numbers and None."""
        seed = seed.tolist() if isinstance(seed, np.ndarray) else seed
        if not isinstance(seed, Sequence):
            first = check_whole("seed", seed, 0, MAX_SEED)
            return [check_whole("seed", first + k, 0, MAX_SEED) for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs}, one for each world, got {len(seed)}")
        return [checked_seed(one) for one in seed]

    def _draw(self, worlds: npt.NDArray[np.bool_]) -> None:
        """Draw the seeds of the next episodes of some worlds, each from the world's own generator."""
        for k in np.flatnonzero(worlds):
            self._seeds[k] = self._generators[k][0].integers(SEEDS)

    def _infos(
        self,
        info: dict[str, Any],
        present: npt.NDArray[np.bool_],
        terminated: npt.NDArray[np.bool_],
        truncated: npt.NDArray[np.bool_],
    ) -> dict[str, Any]:
        """Return infos as arrays over the worlds, each with the mask of the worlds that have it."""
        arrays = {name: np.array(value) for name, value in info.items() if name != "final_observation"}
        fps = self.env.protocol.fps
        arrays["time"] = np.rint(arrays["time"].astype(np.float64) * fps) / fps  # exact, as of GymnasiumEnv
        arrays["is_success"] = arrays["success"].copy()  # see GymnasiumEnv
        arrays |= {"official_terminated": terminated, "official_truncated": truncated}
        return arrays | {f"_{name}": present.copy() for name in arrays}

    def __getstate__(self) -> dict[str, Any]:
        return on_host(self.__dict__, _ON_DEVICE)

    def __setstate__(self, content: dict[str, Any]) -> None:
        self.__dict__.update(on_device(content, _ON_DEVICE, content["_x64"]))


def _keys(seeds: jax.Array) -> jax.Array:
    return jax.vmap(jax.random.key)(seeds)


@partial(jax.jit, static_argnums=0)
def _reset(env: Environment, seeds: jax.Array, games: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
    drawn = jax.vmap(lambda key: jax.random.randint(key, (), 0, params.n_games, np.int32))(_keys(seeds))
    return jax.vmap(env.reset_to, in_axes=(0, None))(jnp.where(games == _ANY_GAME, drawn, games), params)


@jax.jit
def _where(worlds: jax.Array, new: EnvState, old: EnvState) -> EnvState:
    state: EnvState = jax.tree.map(lambda n, o: jnp.where(worlds.reshape(-1, *[1] * (n.ndim - 1)), n, o), new, old)
    return state


@partial(jax.jit, static_argnums=0)
def _info(env: Environment, state: EnvState, params: EnvParams) -> dict[str, Any]:
    info = jax.vmap(env.info, in_axes=(0, None))(state, params)
    info.pop("final_observation", None)  # nothing else of the program needs a call of the host for it
    return info


@partial(jax.jit, static_argnums=0)
def _pictures(env: Environment, params: EnvParams, state: EnvState) -> jax.Array:
    return jax.vmap(lambda one: draw(drawing_of(*env.worlds.pose(params, one)), RENDER_SIZE))(state)


@partial(jax.jit, static_argnums=0)
def _step(
    env: Environment, seeds: jax.Array, state: EnvState, actions: jax.Array, params: EnvParams
) -> tuple[Any, ...]:
    out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(_keys(seeds), state, actions, params)
    return *out, _info(env, out[1], params)

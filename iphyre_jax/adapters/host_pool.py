"""Many worlds with the calls of EnvPool, NumPy in and out: for agents that know no JAX."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import partial
from typing import Any

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.adapters.arguments import as_array, checked_action, refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.checks import MAX_SEED, check_instance, check_whole, show
from iphyre_jax.envs import Environment, EnvParams, EnvState, make
from iphyre_jax.envs.arguments import check_batch, key_of
from iphyre_jax.envs.spaces import Box, Space
from iphyre_jax.execution.forks import check_fork

MAX_WORLDS = 1_000_000

Values = tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]
"""Observations, rewards, terminated, truncated and infos of some worlds."""


class HostPool:
    """B worlds with the calls of EnvPool for gymnasium: `reset` and `step`, or `async_reset`, `send` and `recv`.

    All arrays are NumPy's, with the worlds in front. The worlds play in a thread of their own, so that with
    `batch_size` below `num_envs` the caller computes while others play. An ended episode is followed by the next in the
    same call: the observation is the first of the next, `info["final_observation"]` has the last of the one that ended.
    Terminated and truncated are gymnasium's. `info["env_id"]` has the numbers of the worlds; the rest is as
    `Environment.info` says, after a reset too. Each world has random numbers of its own, so that a seed gives the same
    games in batches of any size.

    Attributes:
        env: the environment.
        params: its games.
        num_envs: B, the number of worlds.
        batch_size: N, the number of worlds of a `send` and a `recv`.
        observation_space: of one world.
        action_space: of one world.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        num_envs: B, 1 to 1,000,000 if memory allows.
        batch_size: N, a divisor of B; B if None.
        seed: of the games, 0 to 2**63 - 1.
        **options: as for `iphyre_jax.make`, except autoreset and final_observation.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    observation_space: Box
    action_space: Space

    def __init__(
        self,
        id: str,
        num_envs: int = 1,
        batch_size: int | None = None,
        seed: int = 0,
        **options: Any,  # noqa: ANN401
    ) -> None:
        self.num_envs = check_whole("num_envs", num_envs, 1, MAX_WORLDS)
        self.batch_size = num_envs if batch_size is None else check_whole("batch_size", batch_size, 1, num_envs)
        if num_envs % self.batch_size:
            raise ValueError(f"batch_size: expected a divisor of {num_envs}, got {batch_size}")
        self._seed = check_whole("seed", seed, 0, MAX_SEED)
        decided = ("autoreset", "final_observation")
        refuse_options(options, decided, ", because the pool resets and tells the final observation")
        self.env, self.params = make(id, autoreset=True, final_observation=True, **options)
        check_batch("num_envs", self.env, num_envs)
        self.observation_space, self.action_space = self.env.observation_space(), self.env.action_space()
        self._key = np.asarray(jax.random.key_data(key_of(self._seed)))
        self._counts = np.zeros(num_envs, np.uint32)  # decisions of each world, resets included
        self._waiting = np.zeros(num_envs, bool)  # worlds whose values the caller has
        self._state: EnvState | None = None  # of all worlds; only the thread below touches it after the first reset
        self._playing: deque[tuple[npt.NDArray[Any] | None, Future[Values]]] = deque()  # worlds that were sent, or None
        self._thread = ThreadPoolExecutor(1, "iphyre_jax_pool")
        self._closed = False

    def reset(self) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin an episode in every world; return the observations, (B, ...), and the info.

        Raises:
            ValueError: the pool gives smaller batches; one line.
        """
        if self.batch_size != self.num_envs:
            raise ValueError(
                f"reset: expected async_reset and recv with a batch_size of {self.batch_size} of {self.num_envs} worlds"
            )
        self.async_reset()
        obs, _, _, _, info = self.recv()
        return obs, info

    def async_reset(self) -> None:
        """Begin an episode in every world; `recv` returns them batch by batch, with rewards of 0.

        Raises:
            ValueError: the pool is closed; one line.
        """
        self._check_open("async_reset")
        wait([future for _, future in self._playing])  # what failed there is of no interest now
        self._playing.clear()
        self._waiting[:] = False
        begun = self._thread.submit(self._reset)
        for first in range(0, self.num_envs, self.batch_size):
            rows = slice(first, first + self.batch_size)
            self._playing.append((None, self._thread.submit(self._first_values, begun, rows)))

    def send(self, actions: Any, env_id: Any = None) -> None:  # noqa: ANN401 - whatever the user takes for them
        """Let worlds play one decision.

        Args:
            actions: (N, ...) members of the action space.
            env_id: (N,) whole numbers, the worlds; may be left out if a batch has all of them.

        Raises:
            ValueError: the actions are not of the action space, a world does not wait for one, or the pool is closed;
                one line.
        """
        self._check_open("send")
        worlds = np.arange(self.num_envs) if env_id is None else as_array("env_id", env_id)
        if worlds.dtype.kind not in "iu" or worlds.shape != (self.batch_size,):
            raise ValueError(f"env_id: expected {self.batch_size} whole numbers, got {show(env_id)}")
        if worlds.min() < 0 or worlds.max() >= self.num_envs or len(np.unique(worlds)) != len(worlds):
            raise ValueError(f"env_id: expected numbers from 0 to {self.num_envs - 1}, each once, got {show(env_id)}")
        if not self._waiting[worlds].all():
            early = int(worlds[~self._waiting[worlds]][0])
            raise ValueError(f"env_id: expected worlds that recv has returned, but world {early} has no such values")
        checked = checked_action(self.action_space, actions, (self.batch_size,))
        self._waiting[worlds] = False
        self._playing.append((worlds, self._thread.submit(self._step, worlds.astype(np.int32), checked)))

    def recv(self) -> Values:
        """Wait for the batch that was sent first, and return its values.

        Returns:
            Observations (N, ...), rewards (N,) float32, terminated (N,) bool, truncated (N,) bool, and the info.

        Raises:
            ValueError: nothing was sent, or the pool is closed; one line.
            Exception: whatever ended the play of the batch; its worlds are as they were and can be sent again. After
                an interrupt `recv` can be called again.
        """
        self._check_open("recv")
        if not self._playing:
            raise ValueError("recv: expected a call of send, reset or async_reset before")
        worlds, future = self._playing[0]
        try:
            values = future.result()
        except Exception:
            self._playing.popleft()
            if worlds is not None:
                self._waiting[worlds] = True
            raise
        self._playing.popleft()
        self._waiting[values[-1]["env_id"]] = True
        return values

    def step(self, actions: Any, env_id: Any = None) -> Values:  # noqa: ANN401
        """Do what `send` and then `recv` do."""
        self.send(actions, env_id)
        return self.recv()

    def close(self) -> None:
        """End the thread; what still plays is dropped."""
        self._closed = True
        self._thread.shutdown(cancel_futures=True)
        self._playing.clear()

    def _check_open(self, call: str) -> None:
        check_fork()
        if self._closed:
            raise ValueError(f"{call}: expected a pool that is open, got one after close")

    def _reset(self) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        with jax.enable_x64(self.env.dtype == "float64"):
            worlds = np.arange(self.num_envs, dtype=np.int32)
            obs, self._state, info = _reset(self.env, self._key, worlds, self._counts, self.params)
        self._counts += 1
        return np.array(obs), {name: np.array(value) for name, value in info.items()}

    def _first_values(self, begun: Future[tuple[npt.NDArray[Any], dict[str, Any]]], rows: slice) -> Values:
        obs, told = begun.result()
        worlds = np.arange(self.num_envs, dtype=np.int32)[rows]
        info = {name: value[rows] for name, value in told.items()} | {"env_id": worlds}
        no = np.zeros(len(worlds), bool)
        return obs[rows], np.zeros(len(worlds), np.float32), no, no.copy(), info

    def _step(self, worlds: npt.NDArray[np.int32], actions: npt.NDArray[Any]) -> Values:
        state = check_instance("state", self._state, EnvState, "a state, from reset")
        with jax.enable_x64(self.env.dtype == "float64"):
            out = _step(self.env, self._key, worlds, self._counts[worlds], state, actions, self.params)
        self._state = out[1]
        self._counts[worlds] += 1
        info = {name: np.array(value) for name, value in out[5].items()} | {"env_id": worlds}
        terminated, truncated = gymnasium_flags(self.env, np.array(out[3]), np.array(out[4]))
        return np.array(out[0]), np.array(out[2]), terminated, truncated, info


def _keys(key: jax.Array, worlds: jax.Array, counts: jax.Array) -> jax.Array:
    """Return the random key of each world's next decision."""
    own = partial(jax.random.fold_in, jax.random.wrap_key_data(key))
    return jax.vmap(lambda world, count: jax.random.fold_in(own(world), count))(worlds, counts)


@partial(jax.jit, static_argnums=0)
def _reset(
    env: Environment, key: jax.Array, worlds: jax.Array, counts: jax.Array, params: EnvParams
) -> tuple[jax.Array, EnvState, dict[str, jax.Array]]:
    obs, state = jax.vmap(env.reset, in_axes=(0, None))(_keys(key, worlds, counts), params)
    return obs, state, jax.vmap(env.info, in_axes=(0, None))(state, params)


@partial(jax.jit, static_argnums=0)
def _step(
    env: Environment,
    key: jax.Array,
    worlds: jax.Array,
    counts: jax.Array,
    state: EnvState,
    actions: jax.Array,
    params: EnvParams,
) -> tuple[Any, ...]:
    own = jax.tree.map(lambda leaf: leaf[worlds], state)
    keys = _keys(key, worlds, counts)
    obs, after, *rest = jax.vmap(env.step, in_axes=(0, 0, 0, None))(keys, own, actions, params)
    return obs, jax.tree.map(lambda leaf, new: leaf.at[worlds].set(new), state, after), *rest

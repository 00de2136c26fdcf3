"""The environment: pure functions of keys, states, actions and parameters, with gymnax's signatures.

    obs, state = env.reset(key, params)
    obs, state, reward, terminated, truncated, info = env.step(key, state, action, params)

They play one world; `jax.vmap` makes a batch, which may mix the parameters' games.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Final, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from iphyre_jax.checks import check_dtype, check_flag, check_instance, check_option, check_whole, cut, show
from iphyre_jax.envs.arguments import check_game, check_key, check_params, check_state
from iphyre_jax.envs.batching.next_game import NO_GAME, NextGame
from iphyre_jax.envs.batching.status import Status
from iphyre_jax.envs.host.worlds import HostWorlds
from iphyre_jax.envs.params import EnvParams, EnvState, Worlds
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.envs.spaces import Box, Space
from iphyre_jax.envs.strategies import Ending, Strategy
from iphyre_jax.envs.traced.worlds import TracedWorlds
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.execution.interrupts import as_interrupts
from iphyre_jax.observations.vectors import ObservationName, observation_size
from iphyre_jax.physics.types import Topology
from iphyre_jax.rules import DECISIONS_PER_SECOND, ELIMINATION_REWARD, FRAMES, SECOND_REWARD, SUCCESS_REWARD
from iphyre_jax.scenes import Limits, Scene, SceneLike, load_scenes
from iphyre_jax.scenes.limits import OFFICIAL, check_limits

BackendName = Literal["host", "xla"]
Info = dict[str, Any]
MAX_IMAGE: Final = 2400  # px, side of an observed image


@dataclass(frozen=True)
class Environment:
    """A strategy over games of some topologies; hashable, hence static under `jax.jit`.

    Environments that differ only in their names are equal and share compiled programs.

    Attributes:
        name: its id, if it has one.
        games: names of the games, in the order of the parameters from `make`.
        strategy: how actions become removals.
        protocol: rate of the physics.
        topologies: those that play its games, see `physics.shared_topologies`.
        dtype: of the physics, "float32" or "float64".
        observation: "official", twelve rows and the candidates, float32 in [0, 1]; "motion", the same with velocities
            and time, Markov except for the solver's cached impulses; "image", (size, size, 3) uint8.
        image_size: px, side of an image; 0 without images.
        autoreset: whether `step` begins a new episode when one ends.
        final_observation: whether `info` has the observation at the end of a decision, before any reset.
        limits: of its scenes: rows of an observation, slots of the strategy.
        backend: "host", a callback inside your program, on all cores of a CPU; "xla", a part of your program, on any
            device, also for forward derivatives.

    Raises:
        ValueError: an attribute is not as said here; one line.
    """

    name: str = field(compare=False)
    games: tuple[str, ...] = field(compare=False)
    strategy: Strategy
    protocol: EpisodeProtocol
    topologies: tuple[Topology, ...]
    dtype: str = "float32"
    observation: ObservationName = "official"
    image_size: int = 0
    autoreset: bool = True
    final_observation: bool = False
    limits: Limits = OFFICIAL
    backend: BackendName = "host"

    def __post_init__(self) -> None:
        """Check the attributes that a user chooses."""
        object.__setattr__(self, "dtype", check_dtype(self.dtype))
        check_option("observation", self.observation, get_args(ObservationName))
        check_option("backend", self.backend, get_args(BackendName))
        check_whole("image_size", self.image_size, 0, MAX_IMAGE, "px")
        check_limits(self.limits)
        for name in ("autoreset", "final_observation"):
            check_flag(name, getattr(self, name))
        check_instance("strategy", self.strategy, Strategy, "one of iphyre_jax.envs.strategies")
        check_instance("protocol", self.protocol, EpisodeProtocol, "an EpisodeProtocol")
        if not isinstance(self.topologies, tuple) or not all(isinstance(one, Topology) for one in self.topologies):
            raise ValueError(f"topologies: expected a tuple of topologies, got {show(self.topologies)}")
        most = min((topology.max_steps for topology in self.topologies), default=self.protocol.steps)
        if self.protocol.steps > most:
            fps = most // FRAMES * DECISIONS_PER_SECOND
            raise ValueError(f"fps: expected at most {fps} for scenes of this size, got {self.protocol.fps}")

    @cached_property
    def worlds(self) -> Worlds:
        """What plays its episodes."""
        protocol = replace(self.protocol, name="")  # names do not matter
        shared = self.topologies, self.dtype, protocol, self.observation, self.limits, self.strategy.no_op_candidate
        return (HostWorlds if self.backend == "host" else TracedWorlds)(*shared, self.final_observation)

    def params(self, scenes: Sequence[SceneLike]) -> EnvParams:
        """Return parameters of other games, which its topologies can play.

        Reset all worlds after a change: a state means nothing with another scene at its row. The host refuses it.

        Args:
            scenes: names, files or scenes; each episode plays one of them at random.

        Raises:
            ValueError: no scenes, a bad one, or one that no topology can play; one line.
            OSError: a scene file cannot be read.
        """
        return self.params_of(load_scenes(scenes, self.limits))

    def params_of(self, scenes: Sequence[Scene]) -> EnvParams:
        """Return scenes as parameters; see `params`.

        Raises:
            ValueError: a scene that no topology of the environment can play; one line.
        """
        check_fork()
        params: EnvParams = self.worlds.params(scenes)
        return params

    def single_game(self, params: EnvParams, game: int) -> tuple[Environment, EnvParams]:
        """Return the environment and the parameters of one game, with the same spaces; it compiles nothing else (host).

        Args:
            params: the games.
            game: row of the parameters. The new environment's `games` is named after this row of `games`, the names of
                `make`; parameters of other games have no names.

        Raises:
            ValueError: there is no such row; one line.
        """
        check_fork()
        check_params(params, self.worlds)
        game = check_whole("game", game, 0, params.n_games - 1)
        topology, own = self.worlds.single_game(params, game)
        return replace(self, games=self.games[game : game + 1], topologies=(topology,)), own

    def alone(self, params: EnvParams, game: int) -> tuple[Environment, EnvParams]:
        """Do what `single_game` does; deprecated."""
        warnings.warn("Environment.alone: use Environment.single_game", DeprecationWarning, stacklevel=2)
        return self.single_game(params, game)

    def reset(self, key: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Begin an episode of a random game, all games being equally likely.

        Args:
            key: random key, typed (`jax.random.key`) or not (`jax.random.PRNGKey`).
            params: the games.

        Returns:
            The observation (see `observation_space`) and the state.

        Raises:
            ValueError: it is not one key, these are no parameters, or JAX lacks the physics' dtype; one line.
        """
        check_fork()  # not in the compiled function, where the child would hang
        check_key(key)
        check_params(params, self.worlds)
        self.check_dtype()
        with as_interrupts():
            out: tuple[jax.Array, EnvState] = self._reset(key, params)
        return out

    @partial(jax.jit, static_argnums=0)
    def _reset(self, key: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        out: tuple[jax.Array, EnvState] = self._reset_to(NextGame.random(key, params.n_games).row(), params)
        return out

    def reset_to(self, game: ArrayLike, params: EnvParams) -> tuple[jax.Array, EnvState]:
        """Begin an episode of a given game.

        Args:
            game: () int32, row of the parameters; a traced number outside the rows stands for the nearest row.
            params: the games.

        Returns:
            See `reset`.

        Raises:
            ValueError: the game is no row of the parameters, or JAX lacks the physics' dtype; one line.
        """
        check_fork()
        check_params(params, self.worlds)
        check_game("game", game, params)
        self.check_dtype()
        with as_interrupts():
            out: tuple[jax.Array, EnvState] = self._reset_to(_nearest_row(game, params), params)
        return out

    @partial(jax.jit, static_argnums=0)
    def _reset_to(self, game: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
        obs, state = self.worlds.reset(params, game)
        return self._observation(params, state, obs), state

    def step(
        self, key: jax.Array, state: EnvState, action: ArrayLike, params: EnvParams
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        """Play one decision.

        Without autoreset an ended episode stays as it is, with a reward of 0 and the same flags.

        Args:
            key: random key that draws the next game under autoreset.
            state: of the episode.
            action: a member of `action_space`; numbers outside it and NaN do nothing.
            params: the games.

        Returns:
            The observation, the state, the reward (() float32: 1000 if solved, -10 a removed block, -1 a second), the
            official flags terminated and truncated (() bool) and the info of the state before any reset, see `info`.

        Raises:
            ValueError: the action has a wrong shape or type, another argument a wrong type, or JAX lacks the physics'
                dtype; one line.
        """
        check_fork()
        if self.autoreset:
            check_key(key)
        check_state(state, params, self.worlds)
        self.check_dtype()
        out: tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]
        checked = self.action_space().array(action)
        with as_interrupts():
            out = self._step(key, state, checked, params)
        return out

    @partial(jax.jit, static_argnums=0)
    def _step(
        self, key: jax.Array, state: EnvState, action: jax.Array, params: EnvParams
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        none = NextGame(jnp.full((), NO_GAME, jnp.int32))
        next_game = NextGame.random(key, params.n_games) if self.autoreset else none
        return self._step_to(state, action, params, next_game)

    def step_to(
        self, state: EnvState, action: jax.Array, params: EnvParams, next_game: jax.Array
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        """Play one decision; if the episode ends, begin one of a given game.

        Args:
            state: of the episode.
            action: an array of the action space.
            params: the games.
            next_game: () int32, row of the parameters, see `reset_to`; -1 to leave an ended episode as it is.

        Returns:
            See `step`.
        """
        check_state(state, params, self.worlds)
        check_game("next_game", next_game, params, NO_GAME)
        return self._step_to(state, action, params, NextGame(_nearest_row(next_game, params, NO_GAME)))

    def _step_to(
        self, state: EnvState, action: jax.Array, params: EnvParams, next_game: NextGame
    ) -> tuple[jax.Array, EnvState, jax.Array, jax.Array, jax.Array, Info]:
        before = self.worlds.status(params, state)
        planned = self.strategy.plan_action(action, before.step, before.executed, before.present, self.protocol)
        ended = self.has_ended(before)
        stop_step = jnp.where(ended, before.step, planned.stop_step)
        executed = jnp.where(ended, before.executed, planned.executed)
        out = self.worlds.step(params, state, planned.plan, stop_step, executed, next_game)
        info = self._info(out.status)
        if self.final_observation:
            info["final_observation"] = self._observation(params, out.final_state, out.final_obs)
        obs = self._observation(params, out.state, out.obs)
        return obs, out.state, self.reward(out.before, out.status), *self.ending(out.status), info

    def observe(self, state: EnvState, params: EnvParams) -> jax.Array:
        """Return the observation of a state; ValueError in one line for a wrong argument, or if JAX lacks the dtype."""
        check_fork()
        check_state(state, params, self.worlds)
        self.check_dtype()
        with as_interrupts():
            out: jax.Array = self._observe(state, params)
        return out

    @partial(jax.jit, static_argnums=0)
    def _observe(self, state: EnvState, params: EnvParams) -> jax.Array:
        obs = None if self.observation == "image" else self.worlds.observe(params, state)
        return self._observation(params, state, obs)

    def _observation(self, params: EnvParams, state: EnvState, obs: jax.Array | None) -> jax.Array:
        """Return an observation: the given numbers, or an image."""
        if self.observation != "image" and obs is not None:
            return obs
        from iphyre_jax.observations.images import image

        return image(*self.worlds.pose(params, state), self.image_size)

    def info(self, state: EnvState, params: EnvParams) -> Info:
        """Return the info of a state, with the same tree as from `step`.

        Returns:
            success, () bool; fault, () int32, 0 for a sound world (see `iphyre_jax.rollouts`); eliminations, () int32,
            blocks removed; time, () float32, seconds played; game, () int32, row of the parameters; with
            `final_observation`, the observation of this state under that name.

        Raises:
            ValueError: these are no state and parameters, or JAX lacks the physics' dtype; one line.
        """
        check_fork()
        check_state(state, params, self.worlds)
        self.check_dtype()
        info = self._info(self.worlds.status(params, state))
        return info | {"final_observation": self.observe(state, params)} if self.final_observation else info

    def _info(self, status: Status) -> Info:
        # A table, as XLA would multiply by 1 / fps, rounded. With `official_bugs` a play may last a frame longer.
        steps = np.arange(self.protocol.steps + self.protocol.steps_per_frame + 1, dtype=np.float32)
        seconds = jnp.asarray(steps / np.float32(self.protocol.fps))
        return {
            "success": status.success,
            "fault": status.fault,
            "eliminations": status.eliminations,
            "time": jnp.take(seconds, status.step, mode="clip"),
            "game": status.game,
        }

    def action_space(self, params: EnvParams | None = None) -> Space:
        """Return the space of actions, the same for all games."""
        del params
        return self.strategy.action_space()

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Return the space of observations, the same for all games."""
        del params
        if self.observation == "image":
            return Box(0, 255, (self.image_size, self.image_size, 3), "uint8")
        candidates = self.strategy.slots + self.strategy.no_op_candidate
        low, high = (float("-inf"), float("inf")) if self.observation == "motion" else (0.0, 1.0)
        return Box(low, high, (observation_size(self.observation, self.limits.objects, candidates),))

    @property
    def num_actions(self) -> int:
        """Number of actions of a discrete strategy, length of an action of the others."""
        space = self.strategy.action_space()
        return space.shape[0] if isinstance(space, Box) else space.n

    def reward(self, before: Status, after: Status) -> jax.Array:
        """Return the reward between two moments of an episode, () float32."""
        solved = (after.success & ~before.success).astype(jnp.float32)
        removed = (after.eliminations - before.eliminations).astype(jnp.float32)
        seconds = (after.step - before.step).astype(jnp.float32) / self.protocol.fps
        return SUCCESS_REWARD * solved + (ELIMINATION_REWARD * removed + SECOND_REWARD * seconds)

    def ending(self, status: Status) -> Ending:
        """Return the official flags of an episode."""
        stopped = (status.step >= self.protocol.steps) | (status.fault != 0)
        return self.strategy.ending(status.success, stopped)

    def has_ended(self, status: Status) -> jax.Array:
        """Return whether an episode has ended, () bool."""
        ending = self.ending(status)
        return ending.terminated | ending.truncated

    def check_dtype(self) -> None:
        """Raise ValueError, one line, if JAX lacks the physics' dtype."""
        if jax.dtypes.canonicalize_dtype(self.dtype) != self.dtype:
            raise ValueError('dtype: expected jax.enable_x64(True) around an environment of dtype "float64"')


def _nearest_row(game: ArrayLike, params: EnvParams, least: int = 0) -> jax.Array:
    """Return the row of the parameters (or `least`) nearest to a number, () int32; it is cut before it is narrowed."""
    row: jax.Array = cut(jnp.asarray(game), least, params.n_games - 1)
    return row

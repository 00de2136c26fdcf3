"""One world as a `gymnasium.Env`."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.adapters.arguments import SEEDS, checked_action, checked_seed, refuse_options
from iphyre_jax.adapters.endings import gymnasium_flags
from iphyre_jax.checks import check_instance, show
from iphyre_jax.envs import EnvParams, EnvState, make
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.params import on_device, on_host
from iphyre_jax.envs.spaces import Discrete, Space
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.observations.drawing import draw
from iphyre_jax.observations.images import drawing_of

RENDER_SIZE = 600  # px


def space_of(space: Space) -> gymnasium.Space[Any]:
    """Return the same space of gymnasium."""
    if isinstance(space, Discrete):
        return gymnasium.spaces.Discrete(space.n)
    if space.dtype == "uint8":
        return gymnasium.spaces.Box(int(space.low), int(space.high), space.shape, np.uint8)
    return gymnasium.spaces.Box(space.low, space.high, space.shape, np.float32)


class GymnasiumEnv(gymnasium.Env[npt.NDArray[Any], Any]):
    """One world as a `gymnasium.Env`, without autoreset.

    Every reset draws one of the id's games with the environment's own generator, so `reset(seed=...)` determines all
    later games; `options={"game": name or number}` selects one. `info` has success (is_success for
    Stable-Baselines3), fault, eliminations, time (s), game (its number), official_terminated and official_truncated.

    Args:
        id: of an environment, see `iphyre_jax.make`.
        render_mode: "rgb_array" for `render` to return the picture of the world, (600, 600, 3) uint8, or None.
        **options: as for `iphyre_jax.make`, except autoreset and final_observation.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012  # gymnasium declares it so

    def __init__(self, id: str, *, render_mode: str | None = None, **options: Any) -> None:  # noqa: ANN401
        check_render_mode(render_mode)
        refuse_options(options, ("autoreset", "final_observation"), ", because the user resets a gymnasium.Env")
        self.env, self.params = make(id, autoreset=False, **options)
        self.render_mode = render_mode
        self.observation_space = space_of(self.env.observation_space())
        self.action_space = space_of(self.env.action_space())
        self._x64 = self.env.dtype == "float64"
        self._games: dict[int, tuple[Environment, EnvParams]] = {}  # those played, so that no others compile
        self._game = 0  # row of the parameters
        self._state: EnvState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[Any], dict[str, Any]]:
        """Begin an episode; see the class.

        Args:
            seed: 0 to 2**63 - 1, or None to continue with the generator.
            options: {"game": name or number}, or None.

        Raises:
            ValueError: the seed is no such number, options["game"] is not a game of this id, or there is another
                option; one line.
        """
        check_fork()
        seed = checked_seed(seed)
        if options is not None:
            check_instance("options", options, dict, 'a dict such as {"game": "hole"} or None')
        if unknown := [name for name in options or {} if name != "game"]:
            raise ValueError(f"options: expected none but game, got {show(unknown[0])}")
        super().reset(seed=seed)
        key = jax.random.key(int(self.np_random.integers(SEEDS)))
        game = (options or {}).get("game")
        with jax.enable_x64(self._x64):
            drawn = jax.random.randint(key, (), 0, self.params.n_games, np.int32)  # like the environment
            self._game = int(drawn) if game is None else game_row(self.env, game)
            env, params = self._single_game(self._game)
            obs, self._state = env.reset_to(np.int32(0), params)
            return np.array(obs), self._infos(_info(env, self._state, params), False, False)

    def step(self, action: Any) -> tuple[npt.NDArray[Any], float, bool, bool, dict[str, Any]]:  # noqa: ANN401
        """Play one decision.

        Raises:
            ValueError: the action is not of the action space, or `reset` was not called; one line.
        """
        check_fork()
        if self._state is None:
            raise ValueError("step: expected a call of reset before the first step")
        checked = checked_action(self.env.action_space(), action, ())
        with jax.enable_x64(self._x64):
            key = jax.random.key(0)  # without autoreset nothing is random
            env, params = self._single_game(self._game)
            obs, self._state, reward, terminated, truncated, info = env.step(key, self._state, checked, params)
            official = bool(terminated), bool(truncated)
            flags = gymnasium_flags(self.env, *official)
            return np.array(obs), float(reward), bool(flags[0]), bool(flags[1]), self._infos(info, *official)

    def render(self) -> npt.NDArray[np.uint8] | None:
        """Return the picture of the world, (600, 600, 3) uint8; None without a render mode."""
        if self.render_mode is None or self._state is None:
            return None
        with jax.enable_x64(self._x64):
            return np.array(_picture(*self._single_game(self._game), self._state))

    def _infos(self, info: dict[str, Any], terminated: bool, truncated: bool) -> dict[str, Any]:
        """Return infos as numbers of Python; time is exact, and the game is the row of all games."""
        found, fps = jax.device_get(info), self.env.protocol.fps
        return {
            "success": bool(found["success"]),
            "is_success": bool(found["success"]),  # the name that Stable-Baselines3 reads
            "fault": int(found["fault"]),
            "eliminations": int(found["eliminations"]),
            "time": round(float(found["time"]) * fps) / fps,
            "game": self._game,
            "official_terminated": terminated,
            "official_truncated": truncated,
        }

    def _single_game(self, game: int) -> tuple[Environment, EnvParams]:
        if game not in self._games:
            self._games[game] = self.env.single_game(self.params, game)
        return self._games[game]

    def __getstate__(self) -> dict[str, Any]:
        return on_host(self.__dict__ | {"_games": {}}, ("params", "_state"))

    def __setstate__(self, content: dict[str, Any]) -> None:
        self.__dict__.update(on_device(content, ("params", "_state"), content["_x64"]))


def check_render_mode(render_mode: object) -> None:
    """Raise ValueError, one line, for a render mode that the environments lack."""
    if render_mode is not None and (not isinstance(render_mode, str) or render_mode != "rgb_array"):
        raise ValueError(f'render_mode: expected "rgb_array" or None, got {show(render_mode)}')


def game_row(env: Environment, game: object) -> int:
    """Return the row of the parameters of a game given by name or number.

    Raises:
        ValueError: it is not a game of the environment; one line.
    """
    if isinstance(game, str) and game in env.games:
        return env.games.index(game)
    if isinstance(game, int | np.integer) and not isinstance(game, bool) and 0 <= game < len(env.games):
        return int(game)
    raise ValueError(f"options: expected a game of {env.name} by name or number, got {show(game)}")


@partial(jax.jit, static_argnums=0)
def _info(env: Environment, state: EnvState, params: EnvParams) -> dict[str, Any]:
    return env.info(state, params)


@partial(jax.jit, static_argnums=0)
def _picture(env: Environment, params: EnvParams, state: EnvState) -> jax.Array:
    return draw(drawing_of(*env.worlds.pose(params, state)), RENDER_SIZE)

"""Scoring of any policy by the paper's protocol: so many episodes of every game, mean reward and share solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.core import Environment, ObservationName
from iphyre_jax.envs.params import EnvParams, EnvState, SceneLike, load_scenes, make_params, mixture_of
from iphyre_jax.envs.protocols import protocol_named
from iphyre_jax.envs.strategies import strategy_named
from iphyre_jax.scenes import GAMES, SPLITS

Policy = Callable[[jax.Array, jax.Array], jax.Array]
"""`policy(key, observation) -> action` for one world, in JAX."""

_COUNTERS = ("success", "eliminations", "time", "fault")


@dataclass(frozen=True, eq=False)
class Scores:
    """Outcomes of G games x E episodes.

    Attributes:
        games: their names.
        reward: (G, E) float64, 1000 if solved - 10 x eliminations - seconds.
        success: (G, E) bool.
        eliminations: (G, E) int64.
        seconds: (G, E) float64, time played.
        fault: (G, E) int64, 0 if the world is sound; an unsound one counts as not solved.
    """

    games: tuple[str, ...]
    reward: npt.NDArray[np.float64]
    success: npt.NDArray[np.bool_]
    eliminations: npt.NDArray[np.int64]
    seconds: npt.NDArray[np.float64]
    fault: npt.NDArray[np.int64]

    @property
    def mean_reward(self) -> float:
        """Mean over games and episodes."""
        return float(self.reward.mean())

    @property
    def success_rate(self) -> float:
        """Share of episodes solved."""
        return float(self.success.mean())

    def by_game(self) -> dict[str, tuple[float, float]]:
        """Return mean reward and share solved of each game."""
        pairs = zip(self.reward.mean(axis=1).tolist(), self.success.mean(axis=1).tolist(), strict=True)
        return dict(zip(self.games, pairs, strict=True))

    def by_split(self) -> dict[str, tuple[float, float]]:
        """Return mean reward and share solved of each split that has games here, every game weighing the same."""
        table = {}
        for split, names in SPLITS.items():
            rows = [k for k, game in enumerate(self.games) if game in names]
            if rows:
                table[split] = float(self.reward[rows].mean()), float(self.success[rows].mean())
        return table


def evaluate(
    policy: Policy,
    split: str | Sequence[SceneLike] = "all",
    *,
    strategy: str,
    protocol: str = "official",
    observation: ObservationName = "official",
    image_size: int = 0,
    episodes: int = 1,
    key: jax.Array | None = None,
    dtype: str = "float32",
) -> Scores:
    """Play every game of a split and score the policy.

    The paper's protocol is one episode a game at 10 steps a second with sampled actions; its human scores are the best
    of five attempts at 60.

    Args:
        policy: `policy(key, observation) -> action`, a JAX function of one world's observation; a deterministic one
            ignores its key.
        split: a split's name, "all" for the forty games, or names, files and scenes.
        strategy: "in-advance", "on-the-fly" or "combined".
        protocol: "official" or "smooth", see `make`.
        observation: what the policy sees, see `make`.
        image_size: px, with observation="image".
        episodes: of each game, all played side by side.
        key: random key; `jax.random.key(0)` if none is given.
        dtype: of the physics; "float64" needs `jax.enable_x64(True)`.

    Raises:
        ValueError: one line naming the argument and what was expected.
    """
    if isinstance(episodes, bool) or not isinstance(episodes, int) or episodes < 1:
        raise ValueError(f"episodes: expected a whole number of at least 1, got {episodes!r}")
    if not callable(policy):
        raise ValueError(f"policy: expected a function of a key and an observation, got {policy!r}")
    scenes = load_scenes(_games(split))
    timing = protocol_named(protocol)
    mixture = mixture_of(scenes, timing, dtype)
    environment = Environment(
        name="evaluation",
        games=tuple(scene.name for scene in scenes),
        strategy=strategy_named(strategy),
        protocol=timing,
        mixture=mixture,
        dtype=dtype,
        observation=observation,
        image_size=image_size,
        autoreset=False,
    )
    params = make_params(scenes, mixture, timing, dtype)
    game = jnp.repeat(jnp.arange(len(scenes), dtype=jnp.int32), episodes)
    keys = jax.random.split(jax.random.key(0) if key is None else key, len(game))
    reward, info = jax.jit(jax.vmap(lambda k, g: play(environment, policy, k, g, params)))(keys, game)
    table = {name: np.asarray(value).reshape(len(scenes), episodes) for name, value in info.items()}
    return Scores(
        games=tuple(scene.name for scene in scenes),
        reward=np.asarray(reward, np.float64).reshape(len(scenes), episodes),
        success=table["success"],
        eliminations=table["eliminations"].astype(np.int64),
        seconds=table["time"].astype(np.float64),
        fault=table["fault"].astype(np.int64),
    )


def play(
    environment: Environment, policy: Policy, key: jax.Array, game: jax.Array, params: EnvParams
) -> tuple[jax.Array, dict[str, Any]]:
    """Play one episode of a game to its end.

    Args:
        environment: without autoreset.
        policy: of one world.
        key: random key.
        game: () int32, row of the parameters.
        params: the games.

    Returns:
        The reward of the episode, () float32, and success, eliminations, time and fault at its end.
    """
    Carry = tuple[jax.Array, jax.Array, EnvState, jax.Array, jax.Array]

    def going(carry: Carry) -> jax.Array:
        return ~carry[4]

    def decide(carry: Carry) -> Carry:
        key, seen, state, total, _ = carry
        key, action_key, step_key = jax.random.split(key, 3)
        action = policy(action_key, seen)
        seen, state, reward, terminated, truncated, _ = environment.step(step_key, state, action, params)
        return key, seen, state, total + reward, terminated | truncated

    seen, state = environment.reset_to(game, params)
    start = key, seen, state, jnp.zeros((), jnp.float32), jnp.zeros((), bool)
    _, _, state, total, _ = jax.lax.while_loop(going, decide, start)
    info = environment.info(state, params)
    return total, {name: info[name] for name in _COUNTERS}


def _games(split: object) -> object:
    """Return the games that a split's name stands for, or what else was given."""
    if split == "all":
        return GAMES
    if isinstance(split, str):
        if split in SPLITS:
            return SPLITS[split]
        raise ValueError(f"split: expected one of all, {', '.join(SPLITS)}, or a sequence of scenes, got {split!r}")
    if isinstance(split, PathLike):
        raise ValueError("split: expected a sequence of scenes, got a single path")
    return split

"""Scoring of any policy by the paper's protocol: so many episodes of every game, mean reward and share solved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batch import Batch
from iphyre_jax.envs.core import Environment, ObservationName
from iphyre_jax.envs.params import SceneLike, load_scenes, make_params, mixture_of
from iphyre_jax.envs.protocols import protocol_named
from iphyre_jax.envs.strategies import strategy_named
from iphyre_jax.envs.unrolling import ActingPolicy, unroll_on_threads
from iphyre_jax.reward import episode_reward
from iphyre_jax.scenes import GAMES, SPLITS, Scene

Policy = Callable[[jax.Array, jax.Array], jax.Array]
"""`policy(key, observation) -> action` for one world, in JAX."""


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
    environment = _environment(scenes, strategy, protocol, observation, image_size, dtype)
    params = make_params(scenes, environment.mixture, environment.protocol, dtype)
    batch = Batch.of(environment, params, np.repeat(np.arange(len(scenes)), episodes))
    key = jax.random.key(0) if key is None else key
    decisions = environment.strategy.decisions
    _, steps = unroll_on_threads(environment, _acting(policy), (), batch, key, decisions=decisions)
    by_game = np.argsort(np.asarray(batch.game), kind="stable")
    last = {name: np.asarray(value)[-1][by_game].reshape(len(scenes), episodes) for name, value in steps.info.items()}
    made = np.rint(last["time"] * environment.protocol.fps).astype(np.int64)
    return Scores(
        games=environment.games,
        reward=episode_reward(last["success"], last["eliminations"], made, environment.protocol.fps),
        success=last["success"],
        eliminations=last["eliminations"].astype(np.int64),
        seconds=made / environment.protocol.fps,
        fault=last["fault"].astype(np.int64),
    )


def _environment(
    scenes: Sequence[Scene], strategy: str, protocol: str, observation: ObservationName, image_size: int, dtype: str
) -> Environment:
    """Return an environment of whole episodes."""
    timing = protocol_named(protocol)
    return Environment(
        name="evaluation",
        games=tuple(scene.name for scene in scenes),
        strategy=strategy_named(strategy),
        protocol=timing,
        mixture=mixture_of(scenes, timing, dtype),
        dtype=dtype,
        observation=observation,
        image_size=image_size,
        autoreset=False,
    )


@lru_cache(maxsize=16)
def _acting(policy: Policy) -> ActingPolicy:
    """Return a policy as `unroll` wants it; the same for the same policy, which is then compiled once."""

    def act(weights: object, key: jax.Array, seen: jax.Array) -> tuple[jax.Array, tuple[()]]:
        del weights
        return policy(key, seen), ()

    return act


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

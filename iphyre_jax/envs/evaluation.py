"""Score a policy as the paper does: so many episodes of every game, mean reward and success rate."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun

from iphyre_jax.checks import check_whole, show
from iphyre_jax.envs.arguments import check_batch, check_key, check_policy
from iphyre_jax.envs.batching.unrolling import Batch, Steps, unroll
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.registry import environment_of
from iphyre_jax.envs.spaces import Discrete
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.observations.vectors import ObservationName
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes import SPLITS, Limits, SceneLike, load_scenes
from iphyre_jax.scenes.library import ALL_GAMES, GAME_LISTS, check_names_differ, looks_like_path

_MOST_EPISODES = 1_000_000  # of each game

Policy = Callable[[jax.Array, jax.Array], jax.Array]
"""`policy(key, observation) -> action` for one world, in JAX."""


@dataclass(frozen=True, eq=False)
class Scores:
    """Results of G games x E episodes.

    Attributes:
        games: their names.
        reward: (G, E) float64, 1000 if solved - 10 x eliminations - seconds.
        success: (G, E) bool.
        eliminations: (G, E) int64.
        seconds: (G, E) float64, time played.
        fault: (G, E) int64, 0 for a sound world; a faulted one counts as not solved.
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
        """Share of the episodes that are solved."""
        return float(self.success.mean())

    def by_game(self) -> dict[str, tuple[float, float]]:
        """Return mean reward and success rate of each game."""
        pairs = zip(self.reward.mean(axis=1).tolist(), self.success.mean(axis=1).tolist(), strict=True)
        return dict(zip(self.games, pairs, strict=True))

    def by_split(self) -> dict[str, tuple[float, float]]:
        """Return mean reward and success rate of each split with games here; all games weigh the same."""
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
    image_size: int | None = None,
    episodes: int = 1,
    key: jax.Array | None = None,
    dtype: str = "float32",
    limits: Limits | None = None,
) -> Scores:
    """Play every game of a split and score the policy.

    The paper's agents play one episode a game at 10 steps a second with sampled actions; its human scores are the best
    of five attempts at 60.

    Args:
        policy: `policy(key, observation) -> action`, a JAX function of one world's observation; a deterministic one
            ignores its key. It must have a hash. An action outside the action space, such as NaN, is an error. Arrays
            that it reads from outside, such as weights, may change between two calls: what computes the same of other
            arrays is compiled once. Only arrays that a `jax.jit` within it closes over are compiled in, and kept.
        split: a split's name, "all" for the forty games, a game or scene file, or a sequence of them and of scenes.
        strategy: "in-advance", "on-the-fly" or "combined".
        protocol: "official" or "smooth", see `make`.
        observation: of the policy, see `make`.
        image_size: px, see `make`.
        episodes: of each game, 1 to 1,000,000 if memory allows, all played side by side.
        key: random key; `jax.random.key(0)` if none is given.
        dtype: of the physics. "float64" is played under `jax.enable_x64(True)`, which may be on or off outside.
        limits: of the scenes, see `make`.

    Raises:
        ValueError: one line naming the argument and what was expected; also if the policy gives an action that the
            action space does not have.
    """
    check_fork()
    check_whole("episodes", episodes, 1, _MOST_EPISODES)
    check_policy(policy, ("a key", "an observation"))
    key = jax.random.key(0) if key is None else key
    check_key(key)
    scenes = load_scenes(_games(split), limits)
    check_names_differ("split", scenes)
    environment, params = environment_of(
        "evaluation",
        scenes,
        strategy=strategy,
        protocol=protocol,
        dtype=dtype,
        observation=observation,
        image_size=image_size,
        autoreset=False,
    )
    decisions = environment.strategy.decisions
    check_batch("episodes", environment, params.n_games * episodes, decisions)
    batch = Batch.of(environment, params, np.repeat(np.arange(params.n_games), episodes))
    with jax.enable_x64(dtype == "float64" or jax.dtypes.canonicalize_dtype("float64") == "float64"):
        acting, weights = _traced(policy, environment, key, batch.obs)
        _, steps = unroll(environment, acting, weights, batch, key, decisions=decisions)
    _check_actions(environment, np.asarray(batch.game), steps)
    return _scores(environment, np.asarray(batch.game), steps)


def _check_actions(environment: Environment, game: npt.NDArray[np.integer[Any]], steps: Steps) -> None:
    """Refuse actions outside the action space: in an environment they do nothing, and a score would hide them.

    Raises:
        ValueError: one line that names the decision and the game.
    """
    action, space = np.asarray(steps.action), environment.action_space()
    low, high = (0, space.n - 1) if isinstance(space, Discrete) else (space.low, space.high)
    within = (action >= low) & (action <= high)  # NaN is not
    wrong = ~within.all(axis=tuple(range(2, action.ndim))) & np.asarray(steps.played)
    if wrong.any():
        decision, world = np.argwhere(wrong)[0].tolist()
        got = action[decision, world][~within[decision, world]].flat[0]
        where = f"in decision {decision + 1} of {environment.games[int(game[world])]}"
        raise ValueError(f"policy: expected actions from {low:g} to {high:g}, got {got} {where}")


def _scores(environment: Environment, game: npt.NDArray[np.integer[Any]], steps: Steps) -> Scores:
    """Return the results of whole episodes, as many of each game; game: (B,) of each world."""
    by_game, fps = np.argsort(game, kind="stable"), environment.protocol.fps
    shape = len(environment.games), -1
    last = {name: np.asarray(value)[-1][by_game].reshape(shape) for name, value in steps.info.items()}
    played = np.rint(last["time"] * fps).astype(np.int64)
    return Scores(
        games=environment.games,
        reward=episode_reward(last["success"], last["eliminations"], played, fps),
        success=last["success"],
        eliminations=last["eliminations"].astype(np.int64),
        seconds=played / fps,
        fault=last["fault"].astype(np.int64),
    )


@dataclass(frozen=True)
class _Traced:
    """A policy for `unroll`, whose weights are the arrays that it closed over; equal ones share a compiled program."""

    text: str
    """Of its jaxpr, in which those arrays have no values, and a sum of those that functions within it closed over."""
    policy: Policy | None
    """If its program calls Python, which the text does not tell apart; else all policies of the same text are one."""
    jaxpr: Jaxpr = field(compare=False, repr=False)

    def __call__(self, weights: Sequence[Any], key: jax.Array, obs: jax.Array) -> tuple[jax.Array, tuple[()]]:
        (action,) = jaxpr_as_fun(ClosedJaxpr(self.jaxpr, weights))(key, obs)
        return action, ()


def _traced(policy: Policy, environment: Environment, key: jax.Array, obs: jax.Array) -> tuple[_Traced, Sequence[Any]]:
    """Return a policy for `unroll` and its weights.

    It is traced at each call: a policy that reads what is trained between two calls, or a new function of the same
    program, is compiled once, and never stale.
    """

    def act(key: jax.Array, obs: jax.Array) -> jax.Array:
        return environment.action_space().array(policy(key, obs))

    closed = jax.make_jaxpr(act)(key, jax.ShapeDtypeStruct(obs.shape[1:], obs.dtype))
    parts = [*_jaxprs(closed.jaxpr)]
    calls_python = any("callback" in equation.primitive.name for jaxpr, _ in parts for equation in jaxpr.eqns)
    text = f"{closed.jaxpr}\n{_sum([const for _, consts in parts for const in consts])}"
    acting = _Traced(text, policy if calls_python else None, closed.jaxpr)
    return acting, [jnp.asarray(const) for const in closed.consts]


def _jaxprs(jaxpr: Jaxpr, consts: Sequence[Any] = ()) -> Iterator[tuple[Jaxpr, Sequence[Any]]]:
    """Yield a jaxpr and all within it, with the arrays that those closed over: JAX compiles their values in."""
    yield jaxpr, consts
    for equation in jaxpr.eqns:
        for value in jax.tree.leaves(equation.params, is_leaf=lambda value: isinstance(value, ClosedJaxpr | Jaxpr)):
            if isinstance(value, ClosedJaxpr):
                yield from _jaxprs(value.jaxpr, value.consts)
            elif isinstance(value, Jaxpr):
                yield from _jaxprs(value)


def _sum(arrays: Sequence[Any]) -> str:
    hasher = hashlib.sha256()
    for array in arrays:
        is_key = jnp.issubdtype(jax.typeof(array).dtype, jax.dtypes.prng_key)
        hasher.update(np.asarray(jax.random.key_data(array) if is_key else array).tobytes())
    return hasher.hexdigest()


def _games(split: object) -> object:
    """Return the games of a split's name, or the given scenes."""
    if isinstance(split, str):
        if split in GAME_LISTS:
            return GAME_LISTS[split]
        if split not in ALL_GAMES and not looks_like_path(split):
            raise ValueError(f"split: expected all, {', '.join(SPLITS)}, a game, a file or scenes, got {show(split)}")
    if not isinstance(split, str | PathLike | Sequence):
        raise ValueError(f"split: expected all, {', '.join(SPLITS)}, a game, a file or scenes, got {show(split)}")
    return [split] if isinstance(split, str | PathLike) else split

"""Playing episodes with a policy: whole ones, from the start to the end, side by side.

Both ways take an `Act`, from random key, observations and the number of decisions for each to decisions, and return a
`Trajectory`; an episode that is over before the last decision is no longer active.

Shapes: S scenes, P episodes of each, B = S x P episodes in the order scene by scene, T decisions at most, D numbers in
an observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.env import observation_table, play
from iphyre_jax.envs.core import Environment
from iphyre_jax.envs.params import EnvParams, EnvState, make_params, mixture_of
from iphyre_jax.envs.protocols import FRAMES
from iphyre_jax.envs.protocols import Protocol as Timing
from iphyre_jax.envs.strategies import strategy_named
from iphyre_jax.reward import episode_reward
from iphyre_jax.rollouts import Outcome
from iphyre_jax.scenes import MAX_ELIMINABLE, SPLITS, Scene, load_scene
from iphyre_jax.train.config import TrainConfig

LANES = 64  # worlds of one topology that are stepped together
LOOK_EVERY = 10  # decisions between looks at whether everything is over, on the fly
DECISIONS = {"on-the-fly": FRAMES, "combined": MAX_ELIMINABLE + 1}  # at most; each combined one but the last removes


class Decision(NamedTuple):
    """What a policy decides for B observations."""

    action: jax.Array  # (B, ...) as the environment takes it
    choice: jax.Array  # (B, ...) as the learner keeps it
    log_prob: jax.Array  # (B,) of the choice, 0 if the algorithm does not ask
    value: jax.Array  # (B,) of the observation, 0 if the algorithm does not ask


Act = Callable[[jax.Array, jax.Array, int], Decision]


class Trajectory(NamedTuple):
    """B whole episodes, for the learner."""

    observation: jax.Array  # (T + 1, B, D) float32; the last one is after the last decision
    choice: jax.Array  # (T, B, ...)
    log_prob: jax.Array  # (T, B)
    value: jax.Array  # (T, B)
    reward: jax.Array  # (T, B) float32, points
    done: jax.Array  # (T, B) bool, the episode ended with this decision
    active: jax.Array  # (T, B) bool, it was not over before


class Played(NamedTuple):
    """How B episodes ended, NumPy arrays (B,)."""

    reward: npt.NDArray[np.float64]
    success: npt.NDArray[np.bool_]
    eliminations: npt.NDArray[np.integer[Any]]
    seconds: npt.NDArray[np.float64]
    fault: npt.NDArray[np.integer[Any]]


class Collector(Protocol):
    """A way to play."""

    def collect(self, act: Act, key: jax.Array, episodes: int) -> tuple[Trajectory, Played]:
        """Play so many episodes of every scene."""


def collector(config: TrainConfig, games: Sequence[str | Scene]) -> Collector:
    """The way to play some games, or scenes of one's own, under a configuration's strategy."""
    if config.strategy == "in-advance":
        return Plans(config, games)
    return Worlds(config, games)


class Plans:
    """In advance: one decision an episode, played on the host by `env.play`, on all cores."""

    def __init__(self, config: TrainConfig, scenes: Sequence[str | Scene]) -> None:
        self._config = config
        self._scenes = tuple(load_scene(scene) for scene in scenes)
        self._table = observation_table(self._scenes)

    def collect(self, act: Act, key: jax.Array, episodes: int) -> tuple[Trajectory, Played]:
        """See `Collector`."""
        config = self._config
        which = np.repeat(np.arange(len(self._scenes)), episodes)
        decision = act(key, jnp.asarray(self._table), episodes)
        actions = np.asarray(decision.action)
        played = play(self._scenes, which, actions, fps=config.fps, resets=config.resets, dtype=config.dtype)
        seen, always = jnp.asarray(self._table[which]), jnp.ones((1, len(which)), bool)
        trajectory = Trajectory(
            observation=jnp.stack([seen, seen]),
            choice=decision.choice[None],
            log_prob=decision.log_prob[None],
            value=decision.value[None],
            reward=jnp.asarray(played.reward[None], jnp.float32),
            done=always,
            active=always,
        )
        return trajectory, Played(
            played.reward, played.success, played.eliminations, played.steps / config.fps, played.fault
        )


class _Table(NamedTuple):
    """Scenes of one topology, as rows of the parameters of their environment."""

    environment: Environment
    params: EnvParams
    scenes: tuple[Scene, ...]


@dataclass(frozen=True)
class _Chunk:
    """Lanes of one topology; those beyond the episodes it serves repeat the last one."""

    environment: Environment
    params: EnvParams
    game: jax.Array  # (LANES,) int32, rows of the parameters
    episode: npt.NDArray[np.int64]  # (LANES,)


class Worlds:
    """On the fly and combined: decision after decision, in the environments of `iphyre_jax.envs`.

    A program steps LANES worlds of one topology, among all games of the package that have it; so it does not depend on
    the agent, the split or the number of episodes, and is compiled once for all of them. Scenes of one's own have
    programs of their own.
    """

    def __init__(self, config: TrainConfig, scenes: Sequence[str | Scene]) -> None:
        self._strategy = config.strategy
        self._timing = Timing("train", config.fps, config.resets)
        self._scenes = tuple(load_scene(scene) for scene in scenes)
        package = tuple(load_scene(game) for games in SPLITS.values() for game in games)
        own = tuple(scene for scene in self._scenes if scene not in package)
        parts = (_tables(config.strategy, self._timing, config.observation, part) for part in (package, own))
        self._tables = [table for part in parts for table in part]
        where = {scene: (k, row) for k, table in enumerate(self._tables) for row, scene in enumerate(table.scenes)}
        self._where = [where[scene] for scene in self._scenes]  # table and row of each scene

    def collect(self, act: Act, key: jax.Array, episodes: int) -> tuple[Trajectory, Played]:
        """See `Collector`."""
        chunks = self._chunks(episodes)
        lane_of = np.empty(len(self._scenes) * episodes, np.int64)
        lane_of[np.concatenate([chunk.episode for chunk in chunks])] = np.arange(len(chunks) * LANES)
        take, give = jnp.asarray(lane_of), [jnp.asarray(chunk.episode) for chunk in chunks]
        begun = [_begin(chunk.environment, chunk.game, chunk.params) for chunk in chunks]
        seen, states = _unzip(begun)
        over = jnp.zeros(len(take), bool)
        steps: list[tuple[jax.Array, ...]] = []
        now = _in_order(seen, take)
        for k in range(DECISIONS[self._strategy]):
            decision = act(jax.random.fold_in(key, k), now, 1)
            after = [
                _step(chunk.environment, state, action, chunk.params)
                for chunk, state, action in zip(chunks, states, _to_lanes(decision.action, give), strict=True)
            ]
            before, (results, states) = now, _unzip(after)
            now, reward, done = _in_order(results, take)
            steps.append((before, decision.choice, decision.log_prob, decision.value, reward, done & ~over, ~over))
            over = over | done
            if k % LOOK_EVERY == LOOK_EVERY - 1 and bool(over.all()):
                break
        ends = _in_order([_counts(state.progress.outcome) for state in states], take)
        return _stacked(steps, now, DECISIONS[self._strategy]), _ended(ends, self._timing.fps)

    def _chunks(self, episodes: int) -> list[_Chunk]:
        """Sort the episodes into chunks of one topology."""
        groups: dict[int, list[int]] = {}
        for index, (k, _) in enumerate(self._where):
            groups.setdefault(k, []).extend(range(index * episodes, (index + 1) * episodes))
        chunks = []
        for k, members in groups.items():
            for start in range(0, len(members), LANES):
                part = np.array(members[start : start + LANES])
                episode = part[np.minimum(np.arange(LANES), len(part) - 1)]
                rows = jnp.asarray([self._where[index][1] for index in episode // episodes], jnp.int32)
                chunks.append(_Chunk(self._tables[k].environment, self._tables[k].params, rows, episode))
        return chunks


@lru_cache(maxsize=4)  # the package's, and few of one's own: variations may be new in every round
def _tables(strategy: str, timing: Timing, observation: Any, scenes: tuple[Scene, ...]) -> tuple[_Table, ...]:  # noqa: ANN401
    """A table for every topology of the scenes."""
    groups: dict[Environment, list[Scene]] = {}
    for scene in scenes:
        mixture = mixture_of([scene], timing, "float32")
        environment = Environment(
            name="train",
            games=(),
            strategy=strategy_named(strategy),
            protocol=timing,
            mixture=mixture,
            observation=observation,
            autoreset=False,
        )
        groups.setdefault(environment, []).append(scene)
    return tuple(
        _Table(env, make_params(members, env.mixture, timing, "float32"), tuple(members))
        for env, members in groups.items()
    )


@partial(jax.jit, static_argnums=0)
def _begin(environment: Environment, game: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
    """Begin an episode in every lane."""
    return jax.vmap(environment.reset_to, in_axes=(0, None))(game, params)


@partial(jax.jit, static_argnums=0, donate_argnums=1)
def _step(
    environment: Environment, state: EnvState, action: jax.Array, params: EnvParams
) -> tuple[tuple[jax.Array, jax.Array, jax.Array], EnvState]:
    """Play one decision in every lane: observation, reward and whether the episode is over; and the state."""
    keys = jax.random.split(jax.random.key(0), action.shape[0])  # not used: nothing is reset
    seen, state, reward, terminated, truncated, _ = jax.vmap(environment.step, in_axes=(0, 0, 0, None))(
        keys, state, action, params
    )
    return (seen, reward, terminated | truncated), state


def _unzip(pairs: Sequence[tuple[Any, Any]]) -> tuple[list[Any], list[Any]]:
    """The first of each pair, the second of each pair."""
    return [first for first, _ in pairs], [second for _, second in pairs]


@jax.jit
def _in_order(of_chunks: Sequence[Any], take: jax.Array) -> Any:  # noqa: ANN401 - any tree of arrays, and the same back
    """From lanes of chunks to episodes."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[take], *of_chunks)


@jax.jit
def _to_lanes(action: jax.Array, give: Sequence[jax.Array]) -> list[jax.Array]:
    """From episodes to lanes of chunks."""
    return [action[episode] for episode in give]


def _stacked(steps: Sequence[tuple[jax.Array, ...]], last: jax.Array, decisions: int) -> Trajectory:
    """Put decisions one after the other, and behind them inactive ones up to the most that there can be."""
    missing = decisions - len(steps)
    columns = [jnp.stack(column) for column in zip(*steps, strict=True)]
    seen = jnp.concatenate([columns[0], jnp.repeat(last[None], missing + 1, axis=0)])
    rest = [jnp.pad(column, [(0, missing)] + [(0, 0)] * (column.ndim - 1)) for column in columns[1:]]
    return Trajectory(seen, *rest)


def _counts(outcome: Outcome) -> tuple[jax.Array, ...]:
    """What is asked of an outcome, the same for all topologies."""
    return outcome.success, outcome.eliminations, outcome.steps, outcome.fault


def _ended(ends: tuple[jax.Array, ...], fps: int) -> Played:
    """The counts of whole episodes as NumPy arrays."""
    solved, removed, made, fault = map(np.asarray, ends)
    reward = episode_reward(solved, removed, made, fps)
    return Played(reward, solved, removed, made / fps, fault)

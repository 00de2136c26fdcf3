"""Playing episodes with a policy: whole ones, from the start to the end, side by side.

Both ways take an `Act`, from random key, observations and the number of decisions for each to decisions, and return a
`Trajectory`; an episode that is over before the last decision is no longer active.

Shapes: S scenes, P episodes of each, B = S x P episodes in the order scene by scene, T decisions at most, D numbers in
an observation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.core import Environment, Info
from iphyre_jax.envs.in_advance import observation_table, play_plans
from iphyre_jax.envs.params import EnvParams, EnvState
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.envs.registry import environment_of
from iphyre_jax.rules import FRAMES, episode_reward
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene, load_scene
from iphyre_jax.train.settings.run import TrainConfig

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
    """In advance: one decision an episode, played on the host by `env.play_plans`, on all cores."""

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
        played = play_plans(self._scenes, which, actions, fps=config.fps, resets=config.resets, dtype=config.dtype)
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


class Worlds:
    """On the fly and combined: decision after decision, in an environment over all of the scenes."""

    def __init__(self, config: TrainConfig, scenes: Sequence[str | Scene]) -> None:
        self._scenes = tuple(load_scene(scene) for scene in scenes)
        self._environment, self._params = environment_of(
            "train",
            self._scenes,
            strategy=config.strategy,
            protocol=EpisodeProtocol("train", config.fps, config.resets),
            dtype="float32",
            observation=config.observation,
            image_size=None,
            autoreset=False,
        )

    def collect(self, act: Act, key: jax.Array, episodes: int) -> tuple[Trajectory, Played]:
        """See `Collector`."""
        environment, params = self._environment, self._params
        games = jnp.repeat(jnp.arange(len(self._scenes), dtype=jnp.int32), episodes)
        now, state = _begin(environment, games, params)
        over = jnp.zeros(len(games), bool)
        steps: list[tuple[jax.Array, ...]] = []
        most = DECISIONS[environment.strategy.name]
        info: Info = {}
        for k in range(most):
            decision = act(jax.random.fold_in(key, k), now, 1)
            before = now
            (now, reward, done, info), state = _step(environment, state, decision.action, params)
            steps.append((before, decision.choice, decision.log_prob, decision.value, reward, done & ~over, ~over))
            over = over | done
            if k % LOOK_EVERY == LOOK_EVERY - 1 and bool(over.all()):
                break
        return _stacked(steps, now, most), _ended(info, environment.protocol.fps)


@partial(jax.jit, static_argnums=0)
def _begin(environment: Environment, game: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
    """Begin an episode in every world."""
    return jax.vmap(environment.reset_to, in_axes=(0, None))(game, params)


@partial(jax.jit, static_argnums=0, donate_argnums=1)
def _step(
    environment: Environment, state: EnvState, action: jax.Array, params: EnvParams
) -> tuple[tuple[jax.Array, jax.Array, jax.Array, Info], EnvState]:
    """Play one decision in every world: observation, reward, whether the episode is over, info; and the state."""
    keys = jax.random.split(jax.random.key(0), action.shape[0])  # not used: nothing is reset
    seen, state, reward, terminated, truncated, info = jax.vmap(environment.step, in_axes=(0, 0, 0, None))(
        keys, state, action, params
    )
    return (seen, reward, terminated | truncated, info), state


def _stacked(steps: Sequence[tuple[jax.Array, ...]], last: jax.Array, decisions: int) -> Trajectory:
    """Put decisions one after the other, and behind them inactive ones up to the most that there can be."""
    missing = decisions - len(steps)
    columns = [jnp.stack(column) for column in zip(*steps, strict=True)]
    seen = jnp.concatenate([columns[0], jnp.repeat(last[None], missing + 1, axis=0)])
    rest = [jnp.pad(column, [(0, missing)] + [(0, 0)] * (column.ndim - 1)) for column in columns[1:]]
    return Trajectory(seen, *rest)


def _ended(info: Info, fps: int) -> Played:
    """Return the counts of whole episodes as NumPy arrays."""
    last = {name: np.asarray(value) for name, value in info.items()}
    made = np.rint(last["time"] * fps).astype(np.int64)
    reward = episode_reward(last["success"], last["eliminations"], made, fps)
    return Played(reward, last["success"], last["eliminations"], made / fps, last["fault"])

"""Rollouts: a policy plays whole episodes side by side.

Both kinds of rollout take a `PolicyFn` and return a `Trajectory`, in which an episode is inactive after its end.

Shapes: S scenes, P episodes of each, B = S x P episodes scene by scene, T decisions at most, D numbers in an
observation.
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
from iphyre_jax.observations.features import MOTION_SIZE
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.train.predictions import open_prediction
from iphyre_jax.train.settings.run import TrainConfig

LOOK_EVERY = 10  # decisions between checks whether all episodes have ended


class PolicyOutput(NamedTuple):
    """A policy's answer to B observations."""

    action: jax.Array  # (B, ...) for the environment
    raw_action: jax.Array  # (B, ...) for the learner: before squashing and clipping
    log_prob: jax.Array  # (B,) of the raw action, 0 if the algorithm does not use it
    value: jax.Array  # (B,) of the observation, 0 if the algorithm does not use it


PolicyFn = Callable[[jax.Array, jax.Array, int], PolicyOutput]  # random key, observations, samples for each of them


class Trajectory(NamedTuple):
    """B whole episodes, for the learner."""

    obs: jax.Array  # (T + 1, B, D) float32; the last one follows the last decision
    raw_action: jax.Array  # (T, B, ...)
    log_prob: jax.Array  # (T, B)
    value: jax.Array  # (T, B)
    reward: jax.Array  # (T, B) float32, points
    done: jax.Array  # (T, B) bool, the episode ended with this decision
    active: jax.Array  # (T, B) bool, it had not ended before


class EpisodeStats(NamedTuple):
    """How B episodes ended, NumPy arrays (B,)."""

    reward: npt.NDArray[np.float64]
    success: npt.NDArray[np.bool_]
    eliminations: npt.NDArray[np.integer[Any]]
    seconds: npt.NDArray[np.float64]
    fault: npt.NDArray[np.integer[Any]]


class RolloutCollector(Protocol):
    """Plays some scenes."""

    def collect(self, policy: PolicyFn, key: jax.Array, episodes: int) -> tuple[Trajectory, EpisodeStats]:
        """Play `episodes` episodes of every scene."""


def rollout_collector(config: TrainConfig, games: Sequence[str | Scene]) -> RolloutCollector:
    """The rollout of a configuration's strategy, for games by name or scenes of one's own."""
    return PlanRollout(config, games) if config.strategy == "in-advance" else StepRollout(config, games)


class PlanRollout:
    """In advance: one decision an episode; the host plays the plans on all cores."""

    def __init__(self, config: TrainConfig, scenes: Sequence[str | Scene]) -> None:
        self._config = config
        self._scenes = tuple(load_scene(scene) for scene in scenes)
        self._table = observation_table(self._scenes)

    def collect(self, policy: PolicyFn, key: jax.Array, episodes: int) -> tuple[Trajectory, EpisodeStats]:
        """See `RolloutCollector`."""
        config = self._config
        which = np.repeat(np.arange(len(self._scenes)), episodes)
        output = policy(key, jax.device_put(self._table), episodes)
        actions = np.asarray(output.action)
        played = play_plans(self._scenes, which, actions, fps=config.fps, resets=config.resets, dtype=config.dtype)
        reward, always = played.reward[None].astype(np.float32), np.ones((1, len(which)), bool)
        obs, reward, always = jax.device_put((np.stack([self._table[which]] * 2), reward, always))
        trajectory = Trajectory(
            obs,
            output.raw_action[None],
            output.log_prob[None],
            output.value[None],
            reward,
            done=always,
            active=always,
        )
        seconds = played.steps / config.fps
        return trajectory, EpisodeStats(played.reward, played.success, played.eliminations, seconds, played.fault)


class StepRollout:
    """On the fly and combined: decision after decision, in an environment over all of the scenes.

    The policy stands between the steps, outside the compiled program of the physics: all agents share that program.
    """

    def __init__(self, config: TrainConfig, scenes: Sequence[str | Scene]) -> None:
        self._scenes = tuple(load_scene(scene) for scene in scenes)
        self._prediction, self._observation = open_prediction(config), config.observation
        self._environment, self._params = environment_of(
            "train",
            self._scenes,
            strategy=config.strategy,
            protocol=EpisodeProtocol("train", config.fps, config.resets),
            dtype="float32",
            observation=config.observation if self._prediction is None else "motion",
            image_size=None,
            autoreset=False,
        )

    def collect(self, policy: PolicyFn, key: jax.Array, episodes: int) -> tuple[Trajectory, EpisodeStats]:
        """See `RolloutCollector`."""
        environment, params = self._environment, self._params
        games = jnp.repeat(jnp.arange(len(self._scenes), dtype=jnp.int32), episodes)
        observed, state = _reset(environment, games, params)
        add_prediction = self._predicting(games)
        next_obs = add_prediction(observed, state)
        active = jnp.ones(len(games), bool)
        steps: list[tuple[jax.Array, ...]] = []
        most = environment.strategy.decisions
        info: Info = {}
        for k in range(most):
            obs, output = next_obs, policy(jax.random.fold_in(key, k), next_obs, 1)
            (observed, reward, done, info), state = _step(environment, state, output.action, params)
            next_obs = add_prediction(observed, state)
            steps.append((obs, *output[1:], reward, done & active, active))
            active = active & ~done
            if k % LOOK_EVERY == LOOK_EVERY - 1 and not bool(active.any()):
                break
        return _stacked(steps, next_obs, most), _stats(info, environment.protocol.fps)

    def _predicting(self, games: jax.Array) -> Callable[[jax.Array, EnvState], jax.Array]:
        """What turns the environment's observations into those of the policy, decision after decision."""
        prediction = self._prediction
        if prediction is None:
            return lambda obs, state: obs
        memory = prediction.start(self._scenes, games, self._environment, self._params)
        shown = None if self._observation == "motion" else -MOTION_SIZE

        def add(obs: jax.Array, state: EnvState) -> jax.Array:
            nonlocal memory
            predicted, memory = prediction.predict(memory, obs, state)
            return jnp.concatenate([obs[:, :shown], predicted], axis=1)

        return add


@partial(jax.jit, static_argnums=0)
def _reset(environment: Environment, game: jax.Array, params: EnvParams) -> tuple[jax.Array, EnvState]:
    """Begin an episode in every world."""
    return jax.vmap(environment.reset_to, in_axes=(0, None))(game, params)


@partial(jax.jit, static_argnums=0, donate_argnums=1)
def _step(
    environment: Environment, state: EnvState, action: jax.Array, params: EnvParams
) -> tuple[tuple[jax.Array, jax.Array, jax.Array, Info], EnvState]:
    """Play one decision in every world: observation, reward, whether the episode is done, info; and the state."""
    keys = jax.random.split(jax.random.key(0), action.shape[0])  # not used: nothing is reset
    obs, state, reward, terminated, truncated, info = jax.vmap(environment.step, in_axes=(0, 0, 0, None))(
        keys, state, action, params
    )
    return (obs, reward, terminated | truncated, info), state


def _stacked(steps: Sequence[tuple[jax.Array, ...]], last_obs: jax.Array, decisions: int) -> Trajectory:
    """Stack the decisions and pad them with inactive ones to the most that there can be."""
    missing = decisions - len(steps)
    columns = [jnp.stack(column) for column in zip(*steps, strict=True)]
    obs = jnp.concatenate([columns[0], jnp.repeat(last_obs[None], missing + 1, axis=0)])
    rest = [jnp.pad(column, [(0, missing)] + [(0, 0)] * (column.ndim - 1)) for column in columns[1:]]
    return Trajectory(obs, *rest)


def _stats(info: Info, fps: int) -> EpisodeStats:
    """How whole episodes ended, from their last info."""
    last = {name: np.asarray(value) for name, value in info.items()}
    steps = np.rint(last["time"] * fps).astype(np.int64)
    reward = episode_reward(last["success"], last["eliminations"], steps, fps)
    return EpisodeStats(reward, last["success"], last["eliminations"], steps / fps, last["fault"])

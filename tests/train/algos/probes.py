"""Probe environments: rewards that are plain functions of what was chosen, with known best answers, no physics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.in_advance import observation_table
from iphyre_jax.observations.features import MOTION_SIZE, ROWS_SIZE
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import OffPolicy
from iphyre_jax.train.settings.run import TrainConfig


class Probe(NamedTuple):
    """What stands in for the games.

    `reward(scene, k, action, good)` gives the points of decision k of B episodes, (B,), whose actions are (B, 6) or
    (B,). `good`, (B,) bool, is a memory that `judge(k, action, good)` changes before; with motion it is seen.
    """

    games: tuple[str, ...]
    length: int  # decisions of an episode
    reward: Callable[[np.ndarray, int, np.ndarray, np.ndarray], np.ndarray]
    judge: Callable[[int, np.ndarray, np.ndarray], np.ndarray] = lambda k, action, good: good


def fitted(config: TrainConfig, probe: Probe) -> TrainConfig:
    """The configuration for a probe's games; a buffer keeps every decision of an update."""
    config, learner = dataclasses.replace(config, games=probe.games), config.learner
    if isinstance(learner, OffPolicy):
        learner = dataclasses.replace(learner, samples_per_update=probe.length * config.episodes_per_update)
    return dataclasses.replace(config, learner=learner)


def observations(config: TrainConfig, probe: Probe) -> np.ndarray:
    """(length + 1, games, D): the real start of each game; with motion, which decision it is and that all is good."""
    table = observation_table(probe.games)
    if config.strategy == "on-the-fly":
        table = np.concatenate([table[:, :ROWS_SIZE], np.zeros((len(table), 2)), table[:, ROWS_SIZE:]], axis=1)
    obs = np.repeat(table[None], probe.length + 1, axis=0)
    if config.observation == "motion":
        motion = np.zeros((*obs.shape[:2], MOTION_SIZE))
        motion[..., 0] = 1.0
        for k in range(probe.length):
            motion[k, :, 1 + k] = 2.0
        obs = np.concatenate([obs, motion], axis=-1)
    return obs.astype(np.float32)


def play(config: TrainConfig, state: Any, key: jax.Array, probe: Probe) -> Trajectory:
    """The episodes of an update."""
    which = np.repeat(np.arange(len(probe.games)), config.episodes_per_scene)
    obs, good = observations(config, probe)[:, which], np.ones(len(which), bool)
    policy = partial(algorithm(config).sample_action, state)
    outputs, reward = [], []
    for k in range(probe.length):
        outputs.append(policy(jax.random.fold_in(key, k), jnp.asarray(obs[k])))
        action = np.asarray(outputs[-1].action)
        good = probe.judge(k, action, good)
        reward.append(probe.reward(which, k, action, good))
        if config.observation == "motion":
            obs[k + 1, :, -MOTION_SIZE] = good
    done = np.zeros((probe.length, len(which)), bool)
    done[-1] = True
    return Trajectory(
        obs=jnp.asarray(obs),
        raw_action=jnp.stack([output.raw_action for output in outputs]),
        log_prob=jnp.stack([output.log_prob for output in outputs]),
        value=jnp.stack([output.value for output in outputs]),
        reward=jnp.asarray(np.stack(reward), jnp.float32),
        done=jnp.asarray(done),
        active=jnp.ones_like(jnp.asarray(done)),
    )


@partial(jax.jit, static_argnums=0)
def first_state(config: TrainConfig, key: jax.Array) -> Any:
    """The state before the first round, of one program: flax would compile each of its operations."""
    return init(config, key)


def learned(config: TrainConfig, probe: Probe) -> Any:
    """The state after all updates."""
    config = fitted(config, probe)
    key, start = jax.random.split(jax.random.key(config.seed))
    state = first_state(config, start)
    for update in range(config.updates):
        play_key, learn_key = jax.random.split(jax.random.fold_in(key, update))
        trajectory = play(config, state, play_key, probe)
        state, _ = algorithm(config).learn(state, learn_key, trajectory, len(probe.games))
    return state


def greedy_actions(config: TrainConfig, probe: Probe, state: Any) -> np.ndarray:
    """(length, games, ...) greedy actions; seconds where they are times."""
    obs = jnp.asarray(observations(config, probe))
    actions = np.stack([np.asarray(algorithm(config).greedy(state, obs[k])) for k in range(probe.length)])
    return 15 * actions if actions.ndim == 3 else actions

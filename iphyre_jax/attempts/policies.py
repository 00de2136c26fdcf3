"""Attempts of trained policies: sampled actions, or the greedy one first. Needs the extra `train`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from iphyre_jax.attempts.protocol import MOST_ATTEMPTS, Attempts
from iphyre_jax.checks import MAX_SEED, check_resets, check_whole, whole_fps
from iphyre_jax.envs.arguments import key_of
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.scenes import GAMES, SceneLike, load_scenes
from iphyre_jax.train.algos.base import State, preferring_where
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.collect import EpisodeStats, PolicyFn, rollout_collector
from iphyre_jax.train.settings.run import TrainConfig


@default_options()
def policy_attempts(
    config: TrainConfig,
    learner: State,
    k: int = 5,
    *,
    greedy_first: bool = False,
    games: Sequence[SceneLike] = GAMES,
    runs: int = 1,
    fps: int = 60,
    resets: int = 1,
    seed: int = 0,
) -> Attempts:
    """Let a trained policy try each game k times, blind: it samples its actions, as it plays to learn.

    Args:
        config: of the policy's training; it gives strategy, observation and number type.
        learner: state of its algorithm.
        k: attempts.
        greedy_first: the first attempt is the greedy one, in every run.
        games: names, scene files and scenes.
        runs: how often the k attempts are made.
        fps: physics steps a second, a multiple of 10; not only those of its training.
        resets: number of the reset.
        seed: of the random numbers.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    tries = check_whole("runs", runs) * check_whole("k", k, 1, MOST_ATTEMPTS)
    check_whole("seed", seed, 0, MAX_SEED)
    scenes = load_scenes(games)
    played = replace(config, fps=whole_fps(fps), resets=check_resets(resets))
    played.check()  # not every policy can play at every rate
    agent = algorithm(played)
    policy: PolicyFn = partial(agent.sample_action, learner)
    if greedy_first:
        policy = preferring_where(np.arange(len(scenes) * tries) % k == 0, agent.greedy_policy(learner), policy)
    stats = rollout_collector(played, scenes).collect(policy, key_of(seed), tries)[1]
    return attempts_of(stats, [scene.name for scene in scenes], runs, k)


def attempts_of(stats: EpisodeStats, games: Sequence[str], runs: int, k: int) -> Attempts:
    """Episodes, game by game, run by run and in order, as attempts."""
    shape = (len(games), runs, k)
    return Attempts(
        games=tuple(games),
        success=stats.success.reshape(shape),
        reward=stats.reward.reshape(shape),
        eliminations=stats.eliminations.reshape(shape),
        seconds=stats.seconds.reshape(shape),
        faults=int((stats.fault != 0).sum()),
    )

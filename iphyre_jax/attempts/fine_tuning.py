"""Attempts of policies that learn on the game that they try: pretrained, or from scratch. Needs the extra `train`.

The first attempt is the greedy plan. The others are sampled in batches, and the policy learns from each batch before
the next. It sees what it did and the rewards, as in training. Every game and run begins anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import jax
import numpy as np

from iphyre_jax.attempts.policies import attempts_of
from iphyre_jax.attempts.protocol import MOST_ATTEMPTS, Attempts
from iphyre_jax.checks import MAX_SEED, check_resets, check_whole, show, whole_fps
from iphyre_jax.envs.arguments import key_of
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.scenes import GAMES, Scene, SceneLike, load_scenes
from iphyre_jax.train.algos.actor_critic import State
from iphyre_jax.train.algos.base import Algorithm, preferring
from iphyre_jax.train.algos.registry import algorithm, init
from iphyre_jax.train.collect import EpisodeStats, rollout_collector
from iphyre_jax.train.settings.agents import A2C, PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage.checkpoint import named_arrays

BATCH: Final = 5  # attempts between two updates
LEARNING_RATE: Final = 1e-3  # both were chosen on the unseen basic games


@dataclass(frozen=True)
class FineTuned:
    """A policy gradient that learns on the game that it tries.

    Attributes:
        config: of the policy's training: in advance, with PPO or A2C.
        pretrained: state of its algorithm; None to begin from scratch.
        batch: attempts between two updates.
        learning_rate: of all updates.
    """

    config: TrainConfig
    pretrained: State | None = None
    batch: int = BATCH
    learning_rate: float = LEARNING_RATE

    @default_options()
    def attempts(
        self,
        k: int = 100,
        *,
        games: Sequence[SceneLike] = GAMES,
        runs: int = 1,
        fps: int = 60,
        resets: int = 1,
        seed: int = 0,
    ) -> Attempts:
        """Try each game k times.

        Args:
            k: attempts; the last batch may be smaller.
            games: names, files or scenes. The place of a game among them decides its random numbers.
            runs: how often the k attempts are made, with other random numbers.
            fps: physics steps a second, a multiple of 10; not only those of its training.
            resets: number of the reset.
            seed: of the random numbers and, from scratch, of the first weights.

        Raises:
            ValueError: one line that names the argument and what was expected.
        """
        check_whole("k", k, 1, MOST_ATTEMPTS)
        check_whole("runs", runs)
        check_whole("batch", self.batch, 2, MOST_ATTEMPTS)
        check_whole("seed", seed, 0, MAX_SEED)
        config = self._config(whole_fps(fps), check_resets(resets))
        self._check_pretrained(config)
        scenes = load_scenes(games)
        parts = []
        for index, scene in enumerate(scenes):
            for run in range(runs):
                key = jax.random.fold_in(jax.random.fold_in(key_of(seed), run), index)
                parts.append(self._try(config, scene, k, key))
        stats = EpisodeStats(*(np.concatenate(column) for column in zip(*parts, strict=True)))
        return attempts_of(stats, [scene.name for scene in scenes], runs, k)

    def _check_pretrained(self, config: TrainConfig) -> None:
        """Refuse a state that is not of one policy with the network of the settings; ValueError in one line."""
        if self.pretrained is None:
            return
        like = jax.eval_shape(lambda: init(config, jax.random.key(0))).params["policy"]
        found, wanted = (
            {name: leaf.shape for name, leaf in named_arrays(tree).items()}
            for tree in (self.pretrained.params.get("policy"), like)
        )
        if found != wanted:
            raise ValueError("pretrained: expected the state of one policy, with the network of config")

    def _config(self, fps: int, resets: int) -> TrainConfig:
        """Settings of learning on one game: the same for all games, so that all share their programs."""
        learner = self.config.learner
        if self.config.strategy != "in-advance" or not isinstance(learner, PPO | A2C):
            raise ValueError(f"config: expected ppo or a2c in advance, got {show(self.config.paper_name)}")
        own: PPO | A2C = replace(
            learner,
            learning_rate=self.learning_rate,
            anneal_lr=False,
            minibatches=1,
            minibatch_of="decisions",
            samples_per_update=self.batch,
        )
        alone: dict[str, Any] = {"variations": 0, "scene_pool": "", "pool_sha256": "", "games": ()}
        return replace(self.config, learner=own, fps=fps, resets=resets, **alone)

    def _try(self, config: TrainConfig, scene: Scene, k: int, key: jax.Array) -> EpisodeStats:
        """The attempts of one game in one run, in order."""
        agent: Algorithm[Any] = algorithm(config)
        first_key, key = jax.random.split(key)
        state = init(config, first_key)
        if self.pretrained is not None:
            state = state._replace(params={**state.params, "policy": self.pretrained.params["policy"]})
        rollout = rollout_collector(config, [scene])
        played = [rollout.collect(preferring(partial(agent.greedy, state)), key, 1)[1]]
        for number in range(-(-(k - 1) // self.batch)):
            play_key, learn_key = jax.random.split(jax.random.fold_in(key, number))
            trajectory, stats = rollout.collect(partial(agent.sample_action, state), play_key, self.batch)
            played.append(stats)
            state, _ = agent.learn(state, learn_key, trajectory, 1)
        return EpisodeStats(*(np.concatenate(column)[:k] for column in zip(*played, strict=True)))

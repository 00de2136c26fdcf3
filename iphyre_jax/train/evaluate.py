"""Evaluation: a trained policy plays games, greedily and with sampled actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.in_advance import action_to_times, observation_table
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.scenes.library import SPLIT_OF, check_games
from iphyre_jax.train.algos.base import State, not_finite, preferring_where
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.collect import EpisodeStats, rollout_collector
from iphyre_jax.train.observations import slot_mask
from iphyre_jax.train.settings.run import TrainConfig

SCHEMA = "iphyre_jax/evaluation"
VERSION = 3
READABLE = (2, 3)  # version 2 has older names of settings, and the same games
MEANS = ("reward", "success", "eliminations", "seconds")
SEED_STREAM = 1  # folded into the run's seed; training derives its keys from the same one, for draws of other shapes


@dataclass(frozen=True)
class Score:
    """Means over some episodes."""

    reward: float
    """Mean reward."""
    success: float
    """Share of episodes solved, 0 to 1."""
    eliminations: float
    """Mean number of blocks removed."""
    seconds: float
    """Mean time played, s."""
    episodes: int


@dataclass(frozen=True)
class GameScore:
    """A policy's scores in one game."""

    game: str
    split: str
    greedy: Score
    sampled: Score
    plan: tuple[float | None, ...]
    """In advance: greedy elimination time of each eliminable block, s, or None if it stays. Else empty."""


@dataclass(frozen=True)
class Evaluation:
    """A policy's scores in many games."""

    games: tuple[GameScore, ...]
    faults: int
    """Episodes whose physics failed; they count as not solved."""

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that occur, in the paper's order."""
        return tuple(split for split in SPLITS if any(game.split == split for game in self.games))

    def mean(self, kind: str, split: str = "all") -> Score:
        """Mean over the games of a split, or over the paper's forty for "all"; kind is "greedy" or "sampled"."""
        chosen = [game for game in self.games if (game.game in GAMES if split == "all" else game.split == split)]
        return _mean_score([getattr(game, kind) for game in chosen])

    def to_json(self) -> dict[str, Any]:
        """Games, split means and faults as JSON values."""
        splits = [*self.splits, *(["all"] if set(GAMES) <= {game.game for game in self.games} else [])]
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "splits": {s: {kind: asdict(self.mean(kind, s)) for kind in ("greedy", "sampled")} for s in splits},
            "games": [asdict(game) for game in self.games],
            "faults": self.faults,
        }


def _mean_score(scores: Sequence[Score]) -> Score:
    """Mean of scores with equal numbers of episodes."""
    means: dict[str, Any] = {name: float(np.mean([getattr(score, name) for score in scores])) for name in MEANS}
    return Score(**means, episodes=sum(score.episodes for score in scores))


def evaluate(config: TrainConfig, learner: State, games: Sequence[str] = GAMES) -> Evaluation:
    """Play every game once greedily and `config.sampled_episodes` times with sampled actions.

    Args:
        config: of the run; it gives strategy, rate, resets, type and seed.
        learner: state of its algorithm.
        games: names of games of the package.

    Raises:
        ValueError: there is no such game, or a number of the policy is not finite; one line that names its array.
    """
    games = check_games(games)
    if name := not_finite(algorithm(config).inference_state(learner)):
        raise ValueError(f"policy: {name}: expected finite numbers, got NaN or infinity: its training diverged")
    agent, episodes = algorithm(config), 1 + config.sampled_episodes
    first = np.arange(len(games) * episodes) % episodes == 0
    policy = preferring_where(first, agent.greedy_policy(learner), partial(agent.sample_action, learner))
    key = jax.random.fold_in(jax.random.key(config.seed), SEED_STREAM)
    stats = rollout_collector(config, games).collect(policy, key, episodes)[1]
    which, plans = np.repeat(np.arange(len(games)), episodes), _plans(config, learner, games)
    scores = tuple(
        GameScore(
            game=game,
            split=SPLIT_OF[game],
            greedy=_score(stats, (which == index) & first),
            sampled=_score(stats, (which == index) & ~first),
            plan=plans[index],
        )
        for index, game in enumerate(games)
    )
    return Evaluation(scores, int((stats.fault != 0).sum()))


def _score(stats: EpisodeStats, chosen: np.ndarray[Any, np.dtype[np.bool_]]) -> Score:
    """Mean over the chosen episodes."""
    means: dict[str, Any] = {name: float(getattr(stats, name)[chosen].mean()) for name in MEANS}
    return Score(**means, episodes=int(chosen.sum()))


def _plans(config: TrainConfig, learner: State, games: Sequence[str]) -> list[tuple[float | None, ...]]:
    """Greedy elimination times of each game's blocks, s, None for one that stays; empty unless in advance."""
    if config.strategy != "in-advance":
        return [()] * len(games)
    obs = jnp.asarray(observation_table(games))
    times = action_to_times(np.asarray(algorithm(config).greedy(learner, obs)))
    steps, blocks = plan_to_steps(times, config.fps, "in_advance"), np.asarray(slot_mask(obs)).sum(axis=1)
    return [
        tuple(None if step < 0 else step / config.fps for step in row[:count].tolist())
        for row, count in zip(steps, blocks, strict=True)
    ]

"""The policies that `benchmarks.learning.carry_over` compares, and how they play."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import jax

from benchmarks.learning.carry_over_rows import Ranking
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.attempts.metrics import best_reward, solved_curve
from iphyre_jax.attempts.policy_tries import PolicyTries
from iphyre_jax.attempts.protocol import Agent, attempts
from iphyre_jax.kept_rows import Row
from iphyre_jax.models.outcome.agent import judge_of
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.storage import OutcomeClassifier
from iphyre_jax.scenes import GAMES, SPLITS, Scene
from iphyre_jax.train.algos.base import State, preferring
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.collect import rollout_collector
from iphyre_jax.train.settings.run import TrainConfig

TRIES: Final = 10  # at each of the forty games ...
RUNS: Final = 5  # ... and how often these are made
DTYPE: Final = "float32"


@dataclass(frozen=True, eq=False)
class Policy:
    """A trained policy, of one run or of several as one.

    Attributes:
        config: settings of its (first) run.
        state: of the algorithm.
        ranker: chooses among its plans ...
        ranking: ... like this.
        sums: SHA-256 of its weights, by name, if they were not trained for these rows but ship with the package.
    """

    config: TrainConfig
    state: State
    ranker: OutcomeClassifier | None = None
    ranking: Ranking | None = None
    sums: Mapping[str, str] = field(default_factory=dict)

    def agent(self) -> PolicyTries:
        """The agent that tries its plans."""
        if self.ranker is None or self.ranking is None:
            return PolicyTries(self.config, self.state)
        weights = {"policy_weight": self.ranking.policy_weight, "greedy_bonus": self.ranking.greedy_bonus}
        return PolicyTries(self.config, self.state, judge=judge_of(self.ranker), **weights)

    def settings(self) -> dict[str, Any]:
        """What decides its rows, as JSON gives it back."""
        count = len(self.state.params.get("members", [self.state]))
        found = settings_of_row(self.config, count, self.ranker.config if self.ranker else None, self.ranking)
        return {**found, **self.sums}


def settings_of_row(
    config: TrainConfig, count: int = 1, ranker: OutcomeConfig | None = None, ranking: Ranking | None = None
) -> dict[str, Any]:
    """Settings of a row, as they come back from JSON: those of the first of its `count` runs, and of its ranker.

    Of the pool's path only the name counts: its sum says what is in it, wherever it lies.
    """
    named = replace(config, scene_pool=",".join(Path(path).name for path in config.pool_paths))
    found: dict[str, Any] = {"settings": json.loads(json.dumps(named.to_json()))}
    if count > 1:
        found["members"] = count
    if ranker is not None and ranking is not None:
        found.update(ranker=ranker.to_json(), **ranking._asdict())
    return found


def held_out_row(policy: Policy, scenes: Sequence[Scene]) -> Row:
    """First tries at the unseen basic games and at held-out generated scenes."""
    play = first_tries if policy.ranker else greedy_scores
    return {"unseen_basic": play(policy, SPLITS["unseen_basic"]), "held_out": play(policy, scenes)}


def greedy_scores(policy: Policy, scenes: Sequence[str | Scene]) -> dict[str, list[float]]:
    """Reward and success of each scene's greedy episode, in order."""
    greedy = preferring(algorithm(policy.config).greedy_policy(policy.state))
    stats = rollout_collector(policy.config, scenes).collect(greedy, jax.random.key(0), 1)[1]
    return {"reward": stats.reward.tolist(), "success": stats.success.astype(float).tolist()}


def first_tries(policy: Policy, scenes: Sequence[str | Scene]) -> dict[str, list[float]]:
    """Reward and success of each scene's first try, in order."""
    config = policy.config
    played = attempts(policy.agent(), 1, games=scenes, fps=config.fps, resets=config.resets, dtype=DTYPE)
    return {"reward": played.reward[:, 0, 0].tolist(), "success": played.success[:, 0, 0].astype(float).tolist()}


def forty_row(agent: Agent, fps: int) -> Row:
    """Best reward and share solved within 1, ..., TRIES tries at each of the forty games."""
    played = attempts(agent, TRIES, runs=RUNS, fps=fps, resets=RESETS[fps], dtype=DTYPE)
    return {
        "best_reward": dict(zip(GAMES, best_reward(played.reward).tolist(), strict=True)),
        "solved": dict(zip(GAMES, solved_curve(played.success).tolist(), strict=True)),
        "faults": played.faults,
    }

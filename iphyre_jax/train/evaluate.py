"""Evaluation: a trained policy plays games, greedily and with sampled actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from iphyre_jax.checks import show
from iphyre_jax.envs.in_advance import action_to_times, observation_table
from iphyre_jax.execution.configuration import default_options
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import GAMES, SPLITS, Scene, SceneLike, load_scene, load_scenes, scene_to_dict
from iphyre_jax.scenes.library import PAPER_SPLITS, SPLIT_OF, check_names_differ, is_game, load_own_scenes
from iphyre_jax.scenes.limits import OFFICIAL
from iphyre_jax.train.algos.base import State, not_finite, preferring_where
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.collect import EpisodeStats, rollout_collector
from iphyre_jax.train.settings.run import TrainConfig

SCHEMA = "iphyre_jax/evaluation"
VERSION = 3
READABLE = (2, 3)  # version 2 has older names of settings, and the same games
MEANS = ("reward", "success", "eliminations", "seconds")
OWN, OTHER = "own", "other"  # splits of scenes that are no games of the package: those trained on, and others
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
    """Its split, OWN or OTHER."""
    greedy: Score
    sampled: Score
    plan: tuple[float | None, ...]
    """In advance: greedy elimination time of each eliminable block, s, or None if it stays. Else empty."""
    scene: Scene | None = None
    """The scene, if it is no game of the package."""

    def to_json(self) -> dict[str, Any]:
        """All fields as JSON values; of a game of the package without the scene."""
        fields = asdict(replace(self, scene=None))
        del fields["scene"]
        return fields | ({} if self.scene is None else {"scene": scene_to_dict(self.scene)})


@dataclass(frozen=True)
class Evaluation:
    """A policy's scores in many games."""

    games: tuple[GameScore, ...]
    faults: int
    """Episodes whose physics failed; they count as not solved."""

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that occur, in the paper's order, then OWN and OTHER."""
        return tuple(split for split in (*SPLITS, OWN, OTHER) if any(game.split == split for game in self.games))

    def mean(self, kind: str, split: str = "all") -> Score:
        """Mean over the games of a split; kind is "greedy" or "sampled".

        For "all", over those of the paper's forty that were played.

        Raises:
            ValueError: no game of the split was played; one line.
        """
        splits = PAPER_SPLITS if split == "all" else (split,)
        chosen = [game for game in self.games if game.split in splits]
        if not chosen:
            raise ValueError(f"split: expected one that was played, of {', '.join(self.splits)}; got {show(split)}")
        return _mean_score([getattr(game, kind) for game in chosen])

    def to_json(self) -> dict[str, Any]:
        """Games, split means and faults as JSON values."""
        whole = sum(game.split in PAPER_SPLITS for game in self.games) == len(GAMES)
        splits = [*self.splits, *(["all"] if whole else [])]
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "splits": {s: {kind: asdict(self.mean(kind, s)) for kind in ("greedy", "sampled")} for s in splits},
            "games": [game.to_json() for game in self.games],
            "faults": self.faults,
        }


def _mean_score(scores: Sequence[Score]) -> Score:
    """Mean of scores with equal numbers of episodes."""
    means: dict[str, Any] = {name: float(np.mean([getattr(score, name) for score in scores])) for name in MEANS}
    return Score(**means, episodes=sum(score.episodes for score in scores))


@default_options()
def evaluate(config: TrainConfig, learner: State, games: Sequence[SceneLike] = GAMES) -> Evaluation:
    """Play every game once greedily and `config.sampled_episodes` times with sampled actions.

    The sampled actions of a game depend on its place among the games, not on those behind it.

    Args:
        config: of the run; it gives strategy, rate, resets, type and seed.
        learner: state of its algorithm.
        games: names, scene files and scenes of official limits, each of another name.

    Raises:
        ValueError: a game cannot be played, or a number of the policy is not finite; one line that names its array.
        OSError: a scene file cannot be read.
    """
    scenes = load_scenes(games)
    check_names_differ("games", scenes)
    if scenes[0].limits != OFFICIAL:  # as all are then
        larger = next(scene.name for scene in map(load_scene, games) if scene.limits != OFFICIAL)
        expected = "scenes without limits of their own, for the networks' sizes"
        raise ValueError(f"games: expected {expected}, got {show(larger)}")
    if name := not_finite(algorithm(config).inference_state(learner)):
        raise ValueError(f"policy: {name}: expected finite numbers, got NaN or infinity: its training diverged")
    agent, episodes = algorithm(config), 1 + config.sampled_episodes
    first = np.arange(len(scenes) * episodes) % episodes == 0
    policy = preferring_where(first, agent.greedy_policy(learner), partial(agent.sample_action, learner))
    key = jax.random.fold_in(jax.random.key(config.seed), SEED_STREAM)
    stats = rollout_collector(config, scenes).collect(policy, key, episodes)[1]
    trained_on = load_own_scenes([game for game in config.games if Path(game).is_file()])
    which, plans = np.repeat(np.arange(len(scenes)), episodes), _plans(config, learner, scenes)
    scores = tuple(
        GameScore(
            game=scene.name,
            split=SPLIT_OF[scene.name] if is_game(scene) else OWN if scene in trained_on else OTHER,
            greedy=_score(stats, (which == index) & first),
            sampled=_score(stats, (which == index) & ~first),
            plan=plans[index],
            scene=None if is_game(scene) else scene,
        )
        for index, scene in enumerate(scenes)
    )
    return Evaluation(scores, int((stats.fault != 0).sum()))


def _score(stats: EpisodeStats, chosen: np.ndarray[Any, np.dtype[np.bool_]]) -> Score:
    """Mean over the chosen episodes."""
    means: dict[str, Any] = {name: float(getattr(stats, name)[chosen].mean()) for name in MEANS}
    return Score(**means, episodes=int(chosen.sum()))


def _plans(config: TrainConfig, learner: State, scenes: Sequence[Scene]) -> list[tuple[float | None, ...]]:
    """Greedy elimination times of each game's blocks, s, None for one that stays; empty unless in advance."""
    if config.strategy != "in-advance":
        return [()] * len(scenes)
    obs = jax.device_put(observation_table(scenes))
    times = action_to_times(np.asarray(algorithm(config).greedy(learner, obs)))
    steps = plan_to_steps(times, config.fps, "in_advance")
    return [
        tuple(None if step < 0 else step / config.fps for step in row[: len(scene.eliminable_blocks)].tolist())
        for row, scene in zip(steps, scenes, strict=True)
    ]

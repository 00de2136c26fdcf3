"""Playing games with a trained policy, greedily and with sampled actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.env import Episodes, observation_table, play
from iphyre_jax.observe import candidate_mask
from iphyre_jax.scenes import GAMES, SPLITS
from iphyre_jax.train import ppo
from iphyre_jax.train.config import TrainConfig

SCHEMA = "iphyre_jax/evaluation"
VERSION = 1
SEED_STREAM = 1  # folded into the run's seed: evaluation draws other numbers than training


@dataclass(frozen=True)
class Score:
    """Mean outcome of some episodes."""

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
    """What a policy attained in one game."""

    game: str
    split: str
    greedy: Score
    sampled: Score
    plan: tuple[float | None, ...]
    """Greedy elimination time of each eliminable block, s; None: it stays."""


@dataclass(frozen=True)
class Evaluation:
    """What a policy attained in many games."""

    games: tuple[GameScore, ...]
    faults: int
    """Episodes whose world was reported as unsound; they count as not solved."""

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
    return Score(
        reward=float(np.mean([score.reward for score in scores])),
        success=float(np.mean([score.success for score in scores])),
        eliminations=float(np.mean([score.eliminations for score in scores])),
        seconds=float(np.mean([score.seconds for score in scores])),
        episodes=sum(score.episodes for score in scores),
    )


def evaluate(config: TrainConfig, params: ppo.Params, games: Sequence[str] = GAMES) -> Evaluation:
    """Play every game once greedily and `config.sampled_plans` times with sampled actions.

    Args:
        config: of the run; its rate, resets, type and seed are used.
        params: of the network.
        games: names of games of the package.
    """
    table = observation_table(games)
    which = np.repeat(np.arange(len(games)), 1 + config.sampled_plans)
    seen = jnp.asarray(table[which])
    key = jax.random.fold_in(jax.random.key(config.seed), SEED_STREAM)
    sampled, _, _ = ppo.collect(config, params, key, seen)
    first = np.arange(len(which)) % (1 + config.sampled_plans) == 0
    actions = np.where(first[:, None], np.asarray(ppo.greedy(config, params, seen)), np.asarray(sampled))
    played = play(games, which, actions, fps=config.fps, resets=config.resets, dtype=config.dtype)
    split_of = {game: split for split, names in SPLITS.items() for game in names}
    scores = tuple(
        GameScore(
            game=game,
            split=split_of[game],
            greedy=_score(played, (which == index) & first, config.fps),
            sampled=_score(played, (which == index) & ~first, config.fps),
            plan=_plan(played.eliminate_at[(which == index) & first][0], table[index], config.fps),
        )
        for index, game in enumerate(games)
    )
    return Evaluation(scores, int((played.fault != 0).sum()))


def _score(played: Episodes, chosen: np.ndarray[Any, np.dtype[np.bool_]], fps: int) -> Score:
    """Mean over the chosen episodes."""
    return Score(
        reward=float(played.reward[chosen].mean()),
        success=float(played.success[chosen].mean()),
        eliminations=float(played.eliminations[chosen].mean()),
        seconds=float(played.steps[chosen].mean() / fps),
        episodes=int(chosen.sum()),
    )


def _plan(
    steps: np.ndarray[Any, np.dtype[np.int64]], seen: np.ndarray[Any, np.dtype[np.float32]], fps: int
) -> tuple[float | None, ...]:
    """Seconds of a plan's eliminations, for the blocks that the observation shows."""
    blocks = int(candidate_mask(seen).sum())
    return tuple(None if step < 0 else step / fps for step in steps[:blocks].tolist())

"""What a planner imagines of the forty games and what the same plans really bring, kept for all questions to it.

Each draw has its own plans and its own displaced scenes. The first N plans of a draw are those of a planner that
draws N and imagines the different ones, and its first K scenes are those of one that believes in K: one row answers for
every N and K.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.analyses.shipped import shipped_model
from iphyre_jax.attempts.agents import random_plans, unrepeated
from iphyre_jax.attempts.planner import displaced, imagined_rewards
from iphyre_jax.kept_rows import Row, kept_row
from iphyre_jax.rules import DECISIONS_PER_SECOND, PEOPLE_FPS, TIME_LIMIT
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.train.observations import start_observations
from iphyre_jax.train.storage.pretrained import load_pretrained

Proposals = Literal["random", "policy"]
Floats = npt.NDArray[np.float64]

RESETS: Final = 1
PLANS: Final = 300  # of a draw
COPIES: Final = 10  # displaced scenes; chosen on generated scenes, see docs/decisions/training.md
POLICY: Final = "ppo-i-objects"
FROM_POLICY: Final = 0.7  # share of its plans among the proposals of kind "policy"; the rest is random
IMAGINED_DTYPE: Final = "float32"
WORLD_DTYPE: Final = "float64"


class RealRewards(NamedTuple):
    """What proposed plans really bring, and which of them no earlier one of their draw equals."""

    reward: Floats  # (draws, PLANS) points
    unrepeated: npt.NDArray[np.bool_]  # (draws, PLANS)


@dataclass(frozen=True)
class Imagination:
    """How plans are imagined.

    Attributes:
        sigma: px, standard deviation of each object's displacement in x and in y.
        fps: physics steps a second in the imagination; the world has 60.
        proposals: where plans come from.
        draws: of plans and displacements.
    """

    sigma: float
    fps: int = PEOPLE_FPS
    proposals: Proposals = "random"
    draws: int = 5

    @property
    def name(self) -> str:
        """Of its folder of rows."""
        return f"imagined-{self.sigma:g}px-{self.fps}fps-{self.proposals}"


def _policy_plans(game: str, draw: int) -> Floats:
    """Sampled plans of POLICY, (n, S) s."""
    policy = load_pretrained(POLICY)
    obs = np.repeat(start_observations(policy.config.strategy, policy.config.observation, [game]), _sampled(), axis=0)
    action = np.asarray(policy.act(jax.random.key(draw), jnp.asarray(obs)), np.float64)
    blocks = len(load_scene(game).eliminable_blocks)
    times = np.round(TIME_LIMIT * action[:, :blocks] * DECISIONS_PER_SECOND) / DECISIONS_PER_SECOND
    return np.where(times > 0, times, np.nan)


def _sampled() -> int:
    return round(FROM_POLICY * PLANS)


def proposed(game: str, draw: int, proposals: Proposals) -> Floats:
    """Return the plans of a draw, (PLANS, S) s, NaN for never."""
    rng = np.random.default_rng([draw, *game.encode()])
    times = random_plans(rng, len(load_scene(game).eliminable_blocks), PLANS)
    if proposals == "policy":
        own = rng.permutation(PLANS)[: _sampled()]  # every N has its share of them
        times[own] = _policy_plans(game, draw)
    return times


def believed(scene: Scene, draw: int, sigma: float) -> Sequence[Scene]:
    """Return the scenes of which a planner takes the world to be one; the scene itself without displacement."""
    rng = np.random.default_rng([draw, round(1000 * sigma), *scene.name.encode(), 1])
    return displaced(scene, COPIES, sigma, rng) if sigma else [scene]


def _imagine(game: str, how: Imagination) -> Row:
    scene = load_scene(game)
    return {
        "imagined": [
            np.round(
                imagined_rewards(
                    believed(scene, draw, how.sigma),
                    proposed(game, draw, how.proposals),
                    fps=how.fps,
                    resets=RESETS,
                    dtype=IMAGINED_DTYPE,
                ),
                3,
            ).tolist()
            for draw in range(how.draws)
        ]
    }


def _play(game: str, proposals: Proposals, draws: int) -> Row:
    scene = load_scene(game)
    real = partial(imagined_rewards, [scene], fps=PEOPLE_FPS, resets=RESETS, dtype=WORLD_DTYPE)
    plans = [proposed(game, draw, proposals) for draw in range(draws)]
    return {
        "reward": [np.round(real(times)[0], 3).tolist() for times in plans],
        "unrepeated": [unrepeated(times).tolist() for times in plans],
    }


def _model_of(proposals: Proposals) -> dict[str, Any]:
    """Settings of the policy that proposes, if one does."""
    return shipped_model("policy", POLICY) if proposals == "policy" else {}


def imagined(folder: Path, game: str, how: Imagination) -> Floats:
    """Return imagined rewards, (draws, K, PLANS) points, computing them if they are missing in `folder`."""
    settings = {**asdict(how), **_model_of(how.proposals), "plans": PLANS, "copies": COPIES, "dtype": IMAGINED_DTYPE}
    row = kept_row(folder / how.name, game, settings, partial(_imagine, game, how))
    return np.array(row["imagined"], np.float64)


def real(folder: Path, game: str, proposals: Proposals, draws: int) -> RealRewards:
    """Return how proposed plans really end; as `imagined`."""
    settings = {"plans": PLANS, "draws": draws, "fps": PEOPLE_FPS, "resets": RESETS, "dtype": WORLD_DTYPE}
    settings["repeated plans"] = "marked"  # rows of before have other settings
    settings |= _model_of(proposals)
    row = kept_row(folder / f"played-{proposals}", game, settings, partial(_play, game, proposals, draws))
    return RealRewards(np.array(row["reward"], np.float64), np.array(row["unrepeated"], bool))

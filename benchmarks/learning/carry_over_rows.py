"""The rows that `benchmarks.learning.carry_over` compares: settings, runs and classifiers of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.attempts.policy_tries import GREEDY_BONUS, POLICY_WEIGHT
from iphyre_jax.models.outcome.ranker import refined
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.settings import settings as outcome_settings
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig, preset

SCENES: Final = 20_000  # of the pool's file, seed 0
TRAINED_ON: Final = 19_000  # the first ones; the others are held out
EVERY: Final = 64  # topologies at most; the generator knows fewer
FEWER: Final = 1_000  # of those that ship, for the row with a small pool
DEFAULT: Final = "default"
ENSEMBLE: Final = "ensemble"  # policies of the default preset as one
LARGE_BATCH: Final = "large-batch"
RANKED: Final = "ranked"  # those policies, whose plans a classifier ranks
REFINED: Final = "refined"  # the same policies, and a classifier that learned from its mistakes as well
CONFIDENT: Final = "confident"  # those, and a greedy plan that the policy is sure of gains
REFINED_DEFAULT: Final = "refined-default"  # that classifier, and the policies of the default preset
REFINED_AGAIN: Final = "refined-again"  # those of CONFIDENT, and a classifier refined once more
PAIRS: Final = "pairs"  # that classifier, and two policies as one
POLICIES_OF: Final = MappingProxyType(  # rows with the policies of another one
    {
        ENSEMBLE: DEFAULT,
        RANKED: LARGE_BATCH,
        REFINED: LARGE_BATCH,
        CONFIDENT: LARGE_BATCH,
        REFINED_DEFAULT: DEFAULT,
        REFINED_AGAIN: LARGE_BATCH,
        PAIRS: LARGE_BATCH,
    }
)
ONE_RATE: Final = (REFINED_DEFAULT, REFINED_AGAIN, PAIRS)
MEMBERS: Final = MappingProxyType({ENSEMBLE: 4, PAIRS: 2})  # policies as one; more were no better
FIRST_REFINEMENTS: Final = MappingProxyType({10: 2, 60: 1})  # of each rate's classifier before REFINED_AGAIN
REFINEMENTS: Final = MappingProxyType({10: 3, 60: 1})  # of each rate's classifier that ships
VARIED_FROM: Final = 3  # the refinement from which on variations of the basic games are among its scenes ...
FRESH_VARIATIONS: Final = 1_000  # ... so many of each game
SEEDS_APART: Final = 10  # of variations of two refinements: those of a seed use the next ones too


class Ranking(NamedTuple):
    """How a classifier ranks the plans of a row's policies."""

    refinements: int
    policy_weight: float = POLICY_WEIGHT
    greedy_bonus: float = GREEDY_BONUS


def ranking_of(name: str, fps: int) -> Ranking | None:
    """How the plans of a row are ranked; None if they are not."""
    confident = Ranking(FIRST_REFINEMENTS[fps])
    plain = confident._replace(greedy_bonus=0.0)
    found = {
        RANKED: Ranking(0, 0.01, 0.0),
        REFINED: plain,
        REFINED_DEFAULT: plain,
        CONFIDENT: confident,
        REFINED_AGAIN: Ranking(REFINEMENTS[fps]),
        PAIRS: Ranking(REFINEMENTS[fps]),
    }
    return found.get(name)


def rows(pool: Path, fps: int) -> Mapping[str, TrainConfig]:
    """The rows of a rate by name: the default preset, and what differs from it in one thing.

    A larger pool takes more updates, or updates of twice the episodes, for which the learning rate is higher and
    minibatches are of whole scenes. The scenes that ship are the first ones of the pool. Those of ONE_RATE are there at
    the rate of the default preset alone.
    """
    base = replace(preset(), fps=fps, resets=RESETS[fps])
    large = replace(base, scene_pool=str(pool), pool_scenes=TRAINED_ON)
    batch = replace(
        large,
        updates=240,
        episodes_per_scene=2 * base.episodes_per_scene,
        pool_topologies=EVERY,
        learner=PPO(learning_rate=6e-4, epochs=3, kl_coef=0.2, minibatch_of="scenes"),
    )
    found = {
        DEFAULT: base,
        "variations": replace(base, scene_pool=""),
        "generated": replace(base, variations=0, pool_share=1.0),
        "large-pool": replace(large, updates=2 * base.updates),
        LARGE_BATCH: batch,
        "small-pool": replace(base, pool_scenes=FEWER),
        "uniform": replace(base, curriculum="uniform"),
        "small-network": replace(base, hidden_sizes=(64, 64)),
    }
    here = [name for name in POLICIES_OF if fps == preset().fps or name not in ONE_RATE]
    found.update({name: found[POLICIES_OF[name]] for name in here})
    return MappingProxyType(found)


def members(root: Path, fps: int, name: str, plain: TrainConfig, seed: int) -> dict[Path, TrainConfig]:
    """Folders and settings of the runs of a row's policy: one, or the next MEMBERS."""
    count, run = MEMBERS.get(name, 1), POLICIES_OF.get(name, name)
    folder = root / f"{fps}fps" / run
    return {folder / f"seed-{k}": replace(plain, seed=k) for k in range(count * seed, count * (seed + 1))}


def ranker_config(fps: int, refinements: int = 0) -> OutcomeConfig:
    """Settings of a rate's classifier, or of its refinements."""
    plain = replace(outcome_settings("ranker"), fps=fps, resets=RESETS[fps])
    return refined(plain) if refinements else plain


ROWS: Final = tuple(rows(Path(), OFFICIAL_FPS))  # all names

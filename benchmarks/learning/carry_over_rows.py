"""The rows that `benchmarks.learning.carry_over` compares: settings, runs and classifiers of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.attempts.policy_tries import GREEDY_BONUS, POLICY_WEIGHT
from iphyre_jax.data.generated.drawing import DEFAULT_KIND, SceneKind
from iphyre_jax.models.outcome.ranker import refined
from iphyre_jax.models.outcome.settings import OutcomeConfig
from iphyre_jax.models.outcome.settings import settings as outcome_settings
from iphyre_jax.rules import OFFICIAL_FPS
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig, preset


class SceneFile(NamedTuple):
    """A file of generated scenes."""

    name: str
    scenes: int
    seed: int
    kind: SceneKind = DEFAULT_KIND

    def path(self, root: Path) -> Path:
        """Where it is in a folder."""
        return root / f"{self.name}.npz"


POOL: Final = SceneFile("pool", 20_000, 0)
TRAINED_ON: Final = 19_000  # the first ones of the pool; the others are held out
UNIONS: Final = SceneFile("unions", 15_000, 0, "unions")


class Fresh(NamedTuple):
    """What a refinement of a classifier plays.

    Attributes:
        files: its scenes, but for variations.
        variations: seed of variations of the basic games; None for none.
        by_policies: whether policies propose the plans; else they are random.
    """

    files: tuple[SceneFile, ...]
    variations: int | None = None
    by_policies: bool = False


def _pool(seed: int) -> SceneFile:
    return SceneFile(f"pool-{seed}", 20_000, seed)


def _unions(seed: int) -> SceneFile:
    return SceneFile(f"unions-{seed}", 15_000, seed, "unions")


FRESH: Final = (  # of each refinement; those of seed 1 are for choices
    Fresh((_pool(2),)),
    Fresh((_pool(3),)),
    Fresh((_pool(4),), 30),
    Fresh((UNIONS,)),
    Fresh((_unions(2),), 50),
    Fresh((_pool(5), _unions(3)), 70, by_policies=True),
    Fresh((_pool(6), _unions(4)), 71, by_policies=True),
)
PROPOSING: Final = 5  # policies of WITH_UNIONS, seeds 0, 1, ..., that propose
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
WITH_UNIONS: Final = "with-unions"  # policies and classifier that learned from unions as well
ON_POLICY: Final = "on-policy"  # those policies, and a classifier refined twice more, with plans of theirs
POLICIES_OF: Final = MappingProxyType(  # rows with the policies of another one
    {
        ENSEMBLE: DEFAULT,
        RANKED: LARGE_BATCH,
        REFINED: LARGE_BATCH,
        CONFIDENT: LARGE_BATCH,
        REFINED_DEFAULT: DEFAULT,
        REFINED_AGAIN: LARGE_BATCH,
        PAIRS: LARGE_BATCH,
        ON_POLICY: WITH_UNIONS,
    }
)
ONE_RATE: Final = (REFINED_DEFAULT, REFINED_AGAIN, PAIRS, WITH_UNIONS, ON_POLICY)
MEMBERS: Final = MappingProxyType({ENSEMBLE: 4, PAIRS: 2})  # policies as one; more were no better
FIRST_REFINEMENTS: Final = MappingProxyType({10: 2, 60: 1})  # of each rate's classifier before REFINED_AGAIN
REFINEMENTS: Final = MappingProxyType({10: len(FRESH), 60: 1})  # of each rate's classifier that ships
FRESH_VARIATIONS: Final = 1_000  # so many of each game


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
        REFINED_AGAIN: Ranking(3),
        PAIRS: Ranking(3),
        WITH_UNIONS: Ranking(5),
        ON_POLICY: Ranking(len(FRESH), greedy_bonus=1.6),
    }
    return found.get(name)


def rows(root: Path, fps: int) -> Mapping[str, TrainConfig]:
    """The rows of a rate by name, with scenes in files of a folder: the default preset, and what differs in one thing.

    A larger pool takes more updates, or updates of twice the episodes, for which the learning rate is higher and
    minibatches are of whole scenes. The scenes that ship are the first ones of the pool. Those of ONE_RATE are there at
    the rate of the default preset alone.
    """
    base = replace(preset(), fps=fps, resets=RESETS[fps])
    large = replace(base, scene_pool=str(POOL.path(root)), pool_scenes=TRAINED_ON)
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
        WITH_UNIONS: replace(
            batch, scene_pool=f"{UNIONS.path(root)},{POOL.path(root)}", pool_scenes=UNIONS.scenes + TRAINED_ON
        ),
    }
    found.update({name: found[of] for name, of in POLICIES_OF.items()})
    return MappingProxyType({n: row for n, row in found.items() if fps == preset().fps or n not in ONE_RATE})


def members(root: Path, fps: int, name: str, plain: TrainConfig, seed: int) -> dict[Path, TrainConfig]:
    """Folders and settings of the runs of a row's policy: one, or the next MEMBERS."""
    count, run = MEMBERS.get(name, 1), POLICIES_OF.get(name, name)
    folder = root / f"{fps}fps" / run
    return {folder / f"seed-{k}": replace(plain, seed=k) for k in range(count * seed, count * (seed + 1))}


def ranker_config(fps: int, refinements: int = 0) -> OutcomeConfig:
    """Settings of a rate's classifier, or of its refinements."""
    plain = replace(outcome_settings("ranker"), fps=fps, resets=RESETS[fps])
    return refined(plain, by_policies=FRESH[refinements - 1].by_policies) if refinements else plain


ROWS: Final = tuple(rows(Path(), OFFICIAL_FPS))  # all names

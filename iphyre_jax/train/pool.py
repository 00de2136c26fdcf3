"""A pool of generated scenes to train on: read at the border, drawn from by a curriculum.

Scenes are drawn in proportion to what can be learned from them, p (1 - p) for a scene that the policy solves with
probability p, and a share of those that it has never played, as in prioritised level replay (Jiang et al. 2021). An
update's scenes come from at most `pool_topologies`: with few, the groups of worlds that play side by side stay full.
Topologies are drawn by the sum of their scenes' weights, then scenes among all of theirs by their own weights. So the
size of a topology counts twice: scenes of large ones are played more often than in proportion, and over a run most
scenes of the smallest are not played.

Shapes: N scenes of the pool, n of them in an update.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.generated import GeneratedScenes, generated_file, load_generated
from iphyre_jax.files import file_sum
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.train.settings.run import TrainConfig

UNSEEN: Final = 0.3  # of the draws go to scenes never played, as long as there are any
FLOOR: Final = 0.02  # added to p (1 - p), so that no scene is given up
PACE: Final = 0.5  # of the way that the running success goes to that of the last episodes
STREAM: Final = 104_729  # so that the pool draws other numbers than anything else

Ints = npt.NDArray[np.integer[Any]]
Floats = npt.NDArray[np.float64]


class Curriculum(NamedTuple):
    """What the policy has done in each scene of the pool; a checkpoint keeps it."""

    success: npt.NDArray[np.float32]  # (N,) running share of episodes solved; 0 before the first
    played: npt.NDArray[np.int32]  # (N,) updates that played the scene


@dataclass(frozen=True, eq=False)
class ScenePool:
    """The scenes of a run's pool.

    Attributes:
        scenes: N.
        kind: (N,) number of each scene's topology, from 0.
    """

    scenes: tuple[Scene, ...]
    kind: Ints

    @classmethod
    def of(cls, scenes: tuple[Scene, ...]) -> ScenePool:
        """Return a pool of scenes."""
        topologies = [topology_of(scene) for scene in scenes]
        numbers = {topology: number for number, topology in enumerate(dict.fromkeys(topologies))}
        return cls(scenes, np.array([numbers[topology] for topology in topologies]))


def with_sum(config: TrainConfig) -> TrainConfig:
    """Return the settings with the SHA-256 sum of their pool; unchanged without a pool.

    Raises:
        OSError, ValueError: one line; a file is missing, changed, of another version, or holds too few scenes.
    """
    if not config.scene_pool:
        return config
    _load(config)
    return replace(config, pool_sha256=_sum_of_files(_files(config)))


def open_pool(config: TrainConfig) -> ScenePool | None:
    """Return the pool of a configuration, None without one; errors as those of `with_sum`."""
    if not config.scene_pool:
        return None
    scenes: list[Scene] = []
    for generated in _load(config):
        scenes.extend(generated.select(np.arange(min(len(generated), config.pool_scenes - len(scenes)))).scenes)
    return ScenePool.of(tuple(scenes))


def _load(config: TrainConfig) -> list[GeneratedScenes]:
    """Read the pool's files if they are those that the settings name."""
    files, named = _files(config), config.scene_pool
    for file in files:
        if not file.is_file():
            raise FileNotFoundError(f"scene_pool: expected a file of generated scenes, there is no {file}")
    found = _sum_of_files(files)
    if config.pool_sha256 not in ("", found):
        raise ValueError(f"scene_pool: expected {named} with SHA-256 {config.pool_sha256}, got {found}: it was changed")
    generated = [load_generated(file) for file in files]
    if (most := sum(map(len, generated))) < config.pool_scenes:
        wanted = f"at most {most}, as {named} holds"
        raise ValueError(f"pool_scenes: expected {wanted}, got {config.pool_scenes} (the preset's unless it is given)")
    return generated


def _files(config: TrainConfig) -> list[Path]:
    """Return the files of the pool, in order."""
    return [generated_file(path) for path in config.pool_paths]


def _sum_of_files(files: Sequence[Path]) -> str:
    """Return the SHA-256 sum of a file, or of the sums of several."""
    sums = [file_sum(file) for file in files]
    return sums[0] if len(sums) == 1 else hashlib.sha256("\n".join(sums).encode()).hexdigest()


def start_curriculum(config: TrainConfig) -> Curriculum | tuple[()]:
    """Return the curriculum before the first update; () without a pool."""
    if not config.scene_pool:
        return ()
    return Curriculum(np.zeros(config.pool_scenes, np.float32), np.zeros(config.pool_scenes, np.int32))


def scene_weights(curriculum: Curriculum, *, learnability: bool) -> Floats:
    """Return the probability of each scene to be drawn, (N,), before topologies are chosen."""
    if not learnability:
        return np.full(len(curriculum.played), 1 / len(curriculum.played))
    unseen, share = curriculum.played == 0, curriculum.success.astype(np.float64)
    new, known = unseen.astype(np.float64), np.where(unseen, 0.0, share * (1 - share) + FLOOR)
    if not unseen.any() or unseen.all():
        return (new + known) / (new + known).sum()
    return UNSEEN * new / new.sum() + (1 - UNSEEN) * known / known.sum()


def draw_scenes(pool: ScenePool, curriculum: Curriculum, count: int, config: TrainConfig, update: int) -> Ints:
    """Draw the pool's scenes of an update, (count,) indices, none twice if there are enough.

    The seed, the update and the curriculum decide them.
    """
    rng = np.random.default_rng([config.seed, update, STREAM])
    weights = scene_weights(curriculum, learnability=config.curriculum == "learnability")
    mass = np.bincount(pool.kind, weights)
    kinds = rng.choice(len(mass), min(config.pool_topologies, len(mass)), replace=False, p=mass / mass.sum())
    weights = np.where(np.isin(pool.kind, kinds), weights, 0.0)
    scarce = np.count_nonzero(weights) < count
    return np.asarray(rng.choice(len(weights), count, replace=bool(scarce), p=weights / weights.sum()))


def recorded(curriculum: Curriculum, which: Ints, success: npt.NDArray[np.bool_]) -> Curriculum:
    """Return the curriculum after an update.

    Args:
        curriculum: before it.
        which: (n,) scenes that were played.
        success: (n, episodes) whether their episodes were solved.
    """
    share, played = curriculum.success.copy(), curriculum.played.copy()
    for scene, found in zip(which.tolist(), success.mean(axis=1).tolist(), strict=True):
        share[scene] += (found - share[scene]) * (PACE if played[scene] else 1.0)
        played[scene] += 1
    return Curriculum(share, played)

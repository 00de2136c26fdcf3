"""Search for a good plan of a game: random plans, then neighbours of the best ones, then a decision in float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import Scene
from iphyre_jax.simulation import simulate
from iphyre_jax.viewer.recording import Recording, record

LATEST = 7.0  # s, latest random removal; the best known plans end earlier
KEPT = 8  # number of best plans whose neighbours are tried
SPREADS = (0.5, 0.2, 0.1, 0.05)  # s, standard deviation of neighbours in each round

Plans = npt.NDArray[np.int64]


def search(scene: Scene, *, plans: int = 2048, seed: int = 0, fps: int = 60) -> Recording:
    """Return the play with the highest reward found.

    Removals happen at different steps and after the start, as when people play. The search runs in float32; float64
    decides among the 64 best plans.

    Args:
        scene: a game.
        plans: number of random plans; each of four rounds then tries half as many neighbours.
        seed: of the random numbers.
        fps: physics steps a second.
    """
    rng, blocks = np.random.default_rng(seed), len(scene.eliminable_blocks)
    tried = with_distinct_steps(random_plans(rng, plans, blocks, fps))
    reward = simulate(scene, tried, fps=fps).reward
    for spread in SPREADS:
        best = tried[np.argsort(-reward, kind="stable")[:KEPT]]
        near = best[rng.integers(0, len(best), plans // 2)]
        moved = near + np.rint(rng.normal(0, spread * fps, near.shape)).astype(np.int64)
        moved = np.where(rng.random(near.shape) < 0.5, near, moved)
        moved = np.where(near == NEVER, NEVER, np.maximum(moved, 1))
        moved[rng.random(near.shape) < 0.1] = NEVER
        moved = with_distinct_steps(moved)
        tried = np.concatenate([tried, moved])
        reward = np.concatenate([reward, simulate(scene, moved, fps=fps).reward])
    order = np.argsort(-reward, kind="stable")[:64]
    exact = simulate(scene, tried[order], fps=fps, dtype="float64").reward
    return record(scene, tried[order][int(np.argmax(exact))], fps=fps)


def random_plans(rng: np.random.Generator, count: int, blocks: int, fps: int) -> Plans:
    """Return random plans (count, blocks). In half of them all removals happen within one second."""
    spread = rng.uniform(0, LATEST, (count, blocks))
    burst = rng.uniform(0, LATEST - 1, (count, 1)) + rng.uniform(0, 1, (count, blocks))
    steps = np.rint(np.where(rng.random((count, 1)) < 0.5, spread, burst) * fps).astype(np.int64) + 1
    removed = rng.integers(0, 1 + blocks, (count, 1)) > rng.permuted(np.tile(np.arange(blocks), (count, 1)), axis=1)
    return np.where(removed, steps, NEVER)


def with_distinct_steps(plans: Plans) -> Plans:
    """Return the plans that remove at most one block before each step."""
    ordered = np.sort(plans, axis=1)
    same = (np.diff(ordered, axis=1) == 0) & (ordered[:, 1:] != NEVER)
    return plans[~same.any(axis=1)]

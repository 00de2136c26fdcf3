"""A planner: it imagines random plans in the simulator, perhaps with objects displaced, and plays the best ones.

With no displacement it knows the physics exactly, so it bounds what planning with a learned model can reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.agents import random_plans, unrepeated
from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.checks import check_dtype, check_least, check_resets, check_whole, whole_fps
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.geometry import Layouts
from iphyre_jax.scenes.variations import jitter
from iphyre_jax.simulation import simulate_many

Floats = npt.NDArray[np.float64]

REPEATED_PLANS: Final = {"repeated plans": "left out"}  # part of the settings of a planner's row: earlier ones had them


@dataclass(frozen=True)
class Planner:
    """An agent that plays the best of its imagined plans, by mean imagined reward.

    Attributes:
        plans: random plans that are drawn; the different ones are imagined.
        sigma: px, standard deviation of each object's displacement in x and in y; 0 for none.
        copies: displaced scenes in which each plan is imagined; without displacement one is enough.
        fps: physics steps a second, in the imagination.
        resets: number of the reset, in the imagination.
        dtype: of the imagined physics.
    """

    plans: int = 100
    sigma: float = 0.0
    copies: int = 3
    fps: int = 60
    resets: int = 1
    dtype: str = "float32"

    def __post_init__(self) -> None:
        check_whole("plans", self.plans)
        check_least("sigma", self.sigma, 0, what="pixels")
        check_whole("copies", self.copies)
        whole_fps(self.fps)
        check_resets(self.resets)
        check_dtype(self.dtype)

    def __call__(self, scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
        """Propose the k best plans as `best_plans` gives them, of those that were not tried."""
        if k > self.plans:
            raise ValueError(f"plans: expected at least {k} imagined plans for as many attempts, got {self.plans}")
        times = different_plans(rng, scene, self.plans, past)
        scenes = displaced(scene, self.copies, self.sigma, rng) if self.sigma else [scene]
        imagined = imagined_rewards(scenes, times, fps=self.fps, resets=self.resets, dtype=self.dtype)
        return best_plans(times, imagined, k)


def different_plans(rng: np.random.Generator, scene: Scene, count: int, past: Sequence[Attempt] = ()) -> Floats:
    """Draw `random_plans` of a scene, and leave out what was drawn before or tried, (N, S) s with N at most `count`.

    If all drawn plans were tried, they come again.
    """
    times = random_plans(rng, len(scene.eliminable_blocks), count)
    new = unrepeated(np.concatenate([*(attempt.times[None] for attempt in past), times]))[len(past) :]
    return times[new if new.any() else unrepeated(times)]


def best_plans(times: Floats, imagined: Floats, k: int) -> Floats:
    """Return the k best plans, (k, S) s, the best first; if there are fewer, they come again.

    Args:
        times: (N, S) s.
        imagined: their rewards, (K, N) points, as `preferred` takes them.
        k: how many.
    """
    return times[np.resize(preferred(imagined), k)]


def imagined_rewards(
    scenes: Sequence[Scene], times: npt.NDArray[np.floating[Any]], *, fps: int, resets: int, dtype: str
) -> Floats:
    """Return the reward of each plan in each scene, (K, N) points.

    Args:
        scenes: K of one topology, as the planner takes the world to be.
        times: (N, S) s, plans; NaN for never.
        fps: physics steps a second.
        resets: number of the reset.
        dtype: of the physics.
    """
    reward = simulate_many(
        scenes,
        np.repeat(np.arange(len(scenes)), len(times)),
        np.tile(plan_to_steps(times, fps, "simulate"), (len(scenes), 1)),
        fps=fps,
        resets=resets,
        dtype=dtype,
    ).reward
    return np.asarray(reward.reshape(len(scenes), len(times)), np.float64)


def preferred(imagined: Floats, weights: Floats | None = None) -> npt.NDArray[np.intp]:
    """Return plans by mean imagined reward, best first; the first one imagined is first among equals.

    Args:
        imagined: (K, N) points.
        weights: (K,) of the scenes; by default all count alike.
    """
    return np.argsort(-np.average(imagined, axis=0, weights=weights), kind="stable")


def displaced(scene: Scene, count: int, sigma: float, rng: np.random.Generator) -> list[Scene]:
    """Return copies of a scene whose blocks and balls are moved, each on its own, by Gaussian amounts in x and y.

    Blocks keep length and angle. Objects may overlap or stick out of the picture.

    Args:
        scene: the original.
        count: copies.
        sigma: px, standard deviation.
        rng: source of the random numbers.
    """
    moves = rng.normal(0, sigma, (count, scene.n_objects, 2))
    layouts = jitter(Layouts.of(scene, count), moves[:, : scene.n_blocks], moves[:, scene.n_blocks :])
    return [_moved(scene, k, layouts.bars[k], layouts.balls[k]) for k in range(count)]


def _moved(scene: Scene, number: int, blocks: npt.NDArray[np.float64], balls: npt.NDArray[np.float64]) -> Scene:
    """The scene with other places, all else equal."""
    name = f"{scene.name}~{number}"[:100]
    return Scene(name, blocks, balls, scene.eliminable, scene.dynamic, scene.joints, scene.springs, limits=scene.limits)

"""Play games under given plans: the host functions that check, batch and collect."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
import numpy.typing as npt
from jax.sharding import Mesh

from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import Share, agree, share_of
from iphyre_jax.execution.plan_batch import ATTEMPTS, PlanBatch, Settings
from iphyre_jax.rollouts import FAULT_OVERFLOW
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes import Scene, load_scene, scene_to_dict

SceneLike = str | PathLike[str] | Scene

_DTYPES = ("float32", "float64")


@dataclass(frozen=True, eq=False)
class Simulation:
    """B plays. Rewards follow the paper: 1000 if solved, -10 a removed block, -1 a second.

    Attributes:
        success: (B,) bool, every ball's centre was below y = 600 after one and the same step.
        steps: (B,) int64, physics steps made, the solving one included.
        eliminations: (B,) int64, blocks removed by then.
        reward: (B,) float64, 1000 success - 10 eliminations - steps / fps.
        fault: (B,) int64, 0 if sound, 1 more contact points than four times its topology's slots, 2 not finite; a
            faulted world stops, unsolved.
        samples: (B, K, N, 3) of the simulation's dtype, x, y (px) and angle (rad) of every object at the start and
            after every `sample_every` steps; NaN from the first sample after an object's removal; the last pose
            repeats once the play is over. None if not asked for. Of several scenes, N is the largest number of objects
            and NaN fills up the others.
    """

    success: npt.NDArray[np.bool_]
    steps: npt.NDArray[np.int64]
    eliminations: npt.NDArray[np.int64]
    reward: npt.NDArray[np.float64]
    fault: npt.NDArray[np.int64]
    samples: npt.NDArray[np.floating[Any]] | None


def simulate(
    scene: SceneLike,
    eliminate_at: npt.ArrayLike,
    *,
    fps: float = 60,
    duration: float = 15.0,
    dtype: str = "float32",
    sample_every: int | None = None,
    resets: int = 1,
    mesh: Mesh | None = None,
) -> Simulation:
    """Play B plans of one scene.

    A host function: it takes and returns NumPy arrays and changes no JAX setting.

    Args:
        scene: a game's name, the path of a scene file, or a Scene.
        eliminate_at: (B, S) integers; column s holds the 0-based index of the physics step before which the s-th
            eliminable block (in list order) is removed, -1 for never. Missing columns mean never; columns beyond the
            scene's blocks must be -1. Blocks that go before the same step go in column order.
        fps: physics steps a second; dt = 1 / fps.
        duration: s; duration x fps must be a whole number of steps.
        dtype: "float32" or "float64".
        sample_every: steps between samples of all poses, or None for no samples.
        resets: number of the reset of a reused space, which decides the order of contacts; 1 is a fresh space, the
            official learning environments play in 2.
        mesh: devices that share the worlds, as of `jax.make_mesh`, whatever its axes are; results are the same bits. If
            it spans processes (`jax.distributed`), each of them makes the same call and gets the whole result. None:
            JAX's default device, and the threads that `configure` sets.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: the scene file cannot be read.
    """
    loaded = load_scene(scene)
    settings = _settings(fps, duration, dtype, resets, sample_every)
    plan = _plan(eliminate_at, [len(loaded.eliminable_blocks)], None)
    return _simulate([loaded], np.zeros(len(plan), np.int64), plan, settings, share_of(mesh))


def simulate_many(
    scenes: Sequence[SceneLike],
    which: npt.ArrayLike,
    eliminate_at: npt.ArrayLike,
    *,
    fps: float = 60,
    duration: float = 15.0,
    dtype: str = "float32",
    sample_every: int | None = None,
    resets: int = 1,
    mesh: Mesh | None = None,
    share_prefixes: bool = False,
) -> Simulation:
    """Play B plans of any mixture of scenes; results come in the caller's order.

    Args:
        scenes: names, files or Scenes.
        which: (B,) integers, the scene of each plan as an index into `scenes`.
        eliminate_at: (B, S) integers, each row as for `simulate`.
        fps: see `simulate`, as for all that follow.
        duration: s.
        dtype: "float32" or "float64".
        sample_every: steps between samples.
        resets: number of the reset.
        mesh: devices that share the worlds.
        share_prefixes: whether plans of a scene that begin alike share the steps of their common beginning, second by
            second: quicker where many plans do, as in a search. In float64 the results are the same bits. Without
            samples only, and not on a mesh that spans processes.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: a scene file cannot be read.
    """
    if isinstance(scenes, str | PathLike | Scene):
        raise ValueError("scenes: expected a sequence of names, files or Scenes, got a single one")
    loaded = [load_scene(scene) for scene in scenes]
    settings = _settings(fps, duration, dtype, resets, sample_every, share_prefixes)
    share = share_of(mesh)
    if settings.share_prefixes and (settings.sample_every is not None or share.ranks > 1):
        raise ValueError("share_prefixes: expected no samples, and no mesh that spans processes")
    index = _integers("which", which, 1)
    if index.size and (index.min() < 0 or index.max() >= len(loaded)):
        raise ValueError(f"which: expected indices into {len(loaded)} scenes, got {index.min()} to {index.max()}")
    plan = _plan(eliminate_at, [len(scene.eliminable_blocks) for scene in loaded], index)
    return _simulate(loaded, index, plan, settings, share)


def _settings(
    fps: float,
    duration: float,
    dtype: str,
    resets: int,
    sample_every: int | None,
    share_prefixes: bool = False,
) -> Settings:
    for name, number in (("fps", fps), ("duration", duration)):
        if isinstance(number, bool) or not isinstance(number, int | float | np.number) or not 0 < number < math.inf:
            raise ValueError(f"{name}: expected a positive number, got {number!r}")
    for name, whole in (("resets", resets), ("sample_every", 1 if sample_every is None else sample_every)):
        if isinstance(whole, bool) or not isinstance(whole, int | np.integer) or whole < 1:
            raise ValueError(f"{name}: expected a whole number of at least 1, got {whole!r}")
    if not isinstance(share_prefixes, bool):
        raise ValueError(f"share_prefixes: expected True or False, got {share_prefixes!r}")
    if dtype not in _DTYPES:
        raise ValueError(f'dtype: expected "float32" or "float64", got {dtype!r}')
    steps = round(float(duration) * float(fps))
    if steps < 1 or abs(float(duration) * float(fps) - steps) > 1e-6 * steps:
        raise ValueError(f"duration: expected duration x fps to be a whole number of steps, got {duration!r} x {fps!r}")
    every = None if sample_every is None else int(sample_every)
    return Settings(float(fps), steps, dtype, int(resets), every, share_prefixes)


def _integers(name: str, value: npt.ArrayLike, ndim: int) -> npt.NDArray[np.int64]:
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name}: expected {ndim} axes of integers, got rows of unequal length") from None
    if array.ndim != ndim or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(f"{name}: expected integers with {ndim} axes, got {array.dtype} of shape {array.shape}")
    return array.astype(np.int64)


def _plan(eliminate_at: npt.ArrayLike, blocks: list[int], which: npt.NDArray[np.int64] | None) -> npt.NDArray[np.int32]:
    """Return the checked plan with as many columns as the scene with the most eliminable blocks has."""
    plan = _integers("eliminate_at", eliminate_at, 2)
    if which is not None and len(which) != len(plan):
        raise ValueError(f"eliminate_at: expected {len(which)} rows as in which, got {len(plan)}")
    if plan.size and plan.min() < -1:
        raise ValueError(f"eliminate_at: expected step indices or -1, got {plan.min()}")
    have = np.array(blocks, np.int64)[np.zeros(len(plan), np.int64) if which is None else which]
    beyond = (np.arange(plan.shape[1]) >= have[:, None]) & (plan != -1)
    if beyond.any():
        row, column = np.argwhere(beyond)[0]
        raise ValueError(
            f"eliminate_at: row {row} removes block {column}, but its scene has {have[row]} eliminable blocks"
        )
    return np.minimum(plan[:, : max(blocks, default=0)], np.iinfo(np.int32).max).astype(np.int32)


def _simulate(
    scenes: list[Scene], which: npt.NDArray[np.int64], plan: npt.NDArray[np.int32], settings: Settings, share: Share
) -> Simulation:
    if share.ranks > 1:
        agree([scene_to_dict(scene) for scene in scenes], which, plan, settings)
    worlds = [cached_world(scene, settings.resets, settings.dtype) for scene in scenes]
    for topology, _ in worlds:
        if settings.steps > (limit := topology.max_steps):
            raise ValueError(f"duration: expected at most {limit} steps for this scene, got {settings.steps}")
    batch = PlanBatch.of(scenes, worlds, which, plan, settings, share)
    left = np.arange(len(plan))
    for attempt in range(ATTEMPTS):
        if left.size:
            batch.play(left, attempt)
            left = left[batch.fault[left] == FAULT_OVERFLOW]
    reward = episode_reward(batch.success, batch.eliminations, batch.steps, settings.fps)
    return Simulation(batch.success, batch.steps, batch.eliminations, reward, batch.fault, batch.samples)

"""`simulate` and `simulate_many`: play games under given plans, on the host."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import jax
import numpy as np
import numpy.typing as npt
from jax.sharding import Mesh

from iphyre_jax.checks import (
    MAX_SECONDS,
    check_dtype,
    check_flag,
    check_fps,
    check_integers,
    check_positive,
    check_resets,
    check_which,
    check_whole,
    is_list,
    show,
)
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.configuration import threads
from iphyre_jax.execution.devices import LANES, Partition, check_same_call, partition_of
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.execution.plan_batch import PlanBatch, Settings
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.memory import check_memory
from iphyre_jax.physics.types import Topology
from iphyre_jax.rules import episode_reward
from iphyre_jax.scenes import Scene, SceneLike, load_scene, scene_to_dict

_MOST_STEPS: Final = 2**31 - 1  # a step's number is an int32


@dataclass(frozen=True, eq=False)
class Simulation:
    """Results of B plans. Rewards follow the paper: 1000 if solved, -10 a removed block, -1 a second.

    Attributes:
        success: (B,) bool, the centres of all balls were below y = 600 after the same step.
        steps: (B,) int64, physics steps made, the solving one included.
        eliminations: (B,) int64, blocks removed by then.
        reward: (B,) float64, 1000 success - 10 eliminations - steps / fps.
        fault: (B,) int64, 0 for a sound world, 1 for more contact points than four times its topology's slots, 2 for
            numbers that are not finite. A faulted world stops, unsolved.
        samples: (B, K, N, 3) of the physics' dtype, x, y (px) and angle (rad) of every object at the start and after
            every `sample_every` steps; None without samples. NaN from the first sample after an object's removal. The
            last pose repeats after the end. N is the largest number of objects of the scenes; NaN pads the others.
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

    This host function takes and returns NumPy arrays and changes no JAX setting.

    Args:
        scene: a game's name, the path of a scene file, or a Scene.
        eliminate_at: (B, S) integers; column s holds the 0-based index of the physics step before which the s-th
            eliminable block (in list order) is removed, -1 for never. Missing columns mean never; columns beyond the
            scene's blocks must be -1. Blocks with the same step are removed in column order. B is limited by memory
            only: a call that needs more than is free is refused with both figures.
        fps: physics steps a second, from 0.001 to 100,000; dt = 1 / fps.
        duration: s, above 0; duration x fps must be a whole number of steps, at most `Topology.max_steps` of the scene
            (8,190 or more).
        dtype: "float32" or "float64".
        sample_every: steps between samples of all poses, 1 to 2**31 - 1, or None for no samples.
        resets: number of the reset of a reused space, 1 to 2**31 - 1, which decides the order of contacts; 1 is a
            fresh space, 2 that of the official learning environments.
        mesh: devices that share the worlds, from `jax.make_mesh`, with any axes; results have the same bits. If it
            spans processes (`jax.distributed`), each process makes the same call and gets the whole result. None:
            JAX's default device, and the threads that `configure` sets.

    Raises:
        ValueError: one line that names the argument and what was expected; also inside
            `jax.jit`, where `rollout` plays.
        OSError: the scene file cannot be read.
    """
    loaded = load_scene(scene)
    settings = _settings(fps, duration, dtype, resets, sample_every)
    plan = _plan(eliminate_at, [len(loaded.eliminable_blocks)], None)
    return _simulate([loaded], np.zeros(len(plan), np.int64), plan, settings, partition_of(mesh))


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
    """Play B plans of any mix of scenes; results come in the caller's order.

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
        share_prefixes: whether plans of a scene that begin alike share the steps of their common prefix, second by
            second. It is faster if many plans do, as in a search. In float64 the results have the same bits. It works
            only without samples, and not on a mesh that spans processes.

    Raises:
        ValueError: one line that names the argument and what was expected.
        OSError: a scene file cannot be read.
    """
    if not is_list(scenes):
        raise ValueError(f"scenes: expected a sequence of names, files or Scenes, got {show(scenes)}")
    loaded = [load_scene(scene) for scene in scenes]
    settings = _settings(fps, duration, dtype, resets, sample_every, share_prefixes)
    partition = partition_of(mesh)
    if settings.share_prefixes and (settings.sample_every is not None or partition.process_count > 1):
        raise ValueError("share_prefixes: expected no samples, and no mesh that spans processes")
    index = check_which(which, len(loaded), _hint_of_tracer)
    plan = _plan(eliminate_at, [len(scene.eliminable_blocks) for scene in loaded], index)
    return _simulate(loaded, index, plan, settings, partition)


def _settings(
    fps: float, duration: float, dtype: str, resets: int, sample_every: int | None, share_prefixes: bool = False
) -> Settings:
    rate = check_fps(fps)
    seconds = check_positive("duration", duration, "a positive number of seconds", MAX_SECONDS)
    every = None if sample_every is None else check_whole("sample_every", sample_every, 1, _MOST_STEPS)
    check_flag("share_prefixes", share_prefixes)
    steps = round(seconds * rate)
    if steps < 1 or abs(seconds * rate - steps) > 1e-6 * steps:
        raise ValueError(f"duration: expected duration x fps to be a whole number of steps, got {duration!r} x {fps!r}")
    return Settings(rate, steps, check_dtype(dtype), check_resets(resets), every, bool(share_prefixes))


def _hint_of_tracer(value: object) -> str:
    """Return what to do about a value that JAX traces, as the end of the message."""
    traced = isinstance(value, jax.core.Tracer)
    return "; simulate runs on the host, inside jax.jit call iphyre_jax.rollout" if traced else ""


def _hint(value: object) -> str:
    """Return what to do about a plan that is no (B, S) array of integers, as the end of the message."""
    if not isinstance(value, np.ndarray):
        return _hint_of_tracer(value)
    if value.dtype.kind == "f" and value.size:
        return "; iphyre_jax.plan_to_steps turns seconds into steps"
    return "; one plan is a batch of one, [plan]" if value.dtype.kind in "iu" and value.ndim == 1 else ""


def _check_memory(scenes: list[Scene], topologies: list[Topology], plan: npt.NDArray[np.int32], of: Settings) -> None:
    """Refuse a call whose results, plans and groups under way need more memory than is free."""
    count, slots = plan.shape
    results = count * (100 + 60 * slots)  # a few numbers a plan, and those that sort the plans
    if of.share_prefixes:  # whole episodes, before and after a segment
        layouts = [episode_layout(topology, of.dtype) for topology in topologies]
        results += 2 * count * max((layout.rows * layout.word_size for layout in layouts), default=0)
    if of.sample_every is None or not count:
        check_memory("eliminate_at", results, "play fewer plans at a time")
        return
    stops, number = of.steps // of.sample_every + 1, np.dtype(of.dtype).itemsize
    samples = count * stops * max(scene.n_objects for scene in scenes) * 3 * number
    lanes = min(count, LANES) * (threads() + 1)  # groups under way, each with its samples twice
    under_way = 2 * stops * lanes * max(topology.moving for topology in topologies) * 3 * number
    check_memory("sample_every", results + samples + under_way, "play fewer plans at a time or take fewer samples")


def _plan(eliminate_at: npt.ArrayLike, blocks: list[int], which: npt.NDArray[np.int64] | None) -> npt.NDArray[np.int32]:
    """Return the checked plan with as many columns as the scene with the most eliminable blocks has."""
    plan = check_integers("eliminate_at", eliminate_at, "integers of shape (B, S)", 2, _hint)
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
    return np.minimum(plan[:, : max(blocks, default=0)], _MOST_STEPS).astype(np.int32)


def _simulate(
    scenes: list[Scene],
    which: npt.NDArray[np.int64],
    plan: npt.NDArray[np.int32],
    settings: Settings,
    partition: Partition,
) -> Simulation:
    check_fork()
    if partition.process_count > 1:
        check_same_call([scene_to_dict(scene) for scene in scenes], which, plan, settings)
    worlds = [cached_world(scene, settings.resets, settings.dtype) for scene in scenes]
    for topology, _ in worlds:
        if settings.steps > (limit := topology.max_steps):
            raise ValueError(f"duration: expected at most {limit} steps for this scene, got {settings.steps}")
    _check_memory(scenes, [topology for topology, _ in worlds], plan, settings)
    batch = PlanBatch(scenes, worlds, which, plan, settings, partition)
    batch.play()
    reward = episode_reward(batch.success, batch.eliminations, batch.steps, settings.fps)
    return Simulation(batch.success, batch.steps, batch.eliminations, reward, batch.fault, batch.samples)

"""Compiled programs and the chunks of worlds that run on them.

One program per topology and dtype plays any scene of that topology at any frame rate, length and sampling: worlds run
in chunks of a fixed number of lanes. Chunks are independent, so they are handed to as many threads as there are cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from threading import Lock
from typing import Any, TypeVar

import jax
import numpy as np
import numpy.typing as npt

from iphyre_jax import configuration, rollouts
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.scenes.build import build
from iphyre_jax.scenes.limits import MAX_ELIMINABLE
from iphyre_jax.scenes.schema import Scene

LANES = 128  # worlds a chunk: their state stays in the cache of a core

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Program:
    """Compiled `rollouts.begin` and `rollouts.advance` for chunks of one topology and dtype."""

    begin: Callable[[World, npt.NDArray[np.bool_]], rollouts.Progress]
    advance: Callable[[World, Timing, npt.NDArray[np.int32], rollouts.Progress, np.int32], rollouts.Progress]


_LOCKS: dict[tuple[Topology, str, int], Lock] = {}  # the number counts the columns of a plan
_PROGRAMS: dict[tuple[Topology, str, int], Program] = {}
# By the identity of a `World` that `built` keeps, and its topology.
_STARTS: dict[tuple[int, Topology], tuple[World, rollouts.Progress]] = {}


@cache
def built(scene: Scene, resets: int, dtype: str) -> tuple[Topology, World]:
    """Return topology and numbers of a scene, computed once."""
    return build(scene, resets=resets, dtype=dtype)


def _program(topology: Topology, dtype: str, world: World, timing: Timing, plan: npt.NDArray[np.int32]) -> Program:
    """Return the program of a topology, compiled when first asked for; different ones compile side by side."""
    key = topology, dtype, len(plan)
    with _LOCKS.setdefault(key, Lock()):
        if key not in _PROGRAMS:
            begin = jax.jit(partial(rollouts.begin, topology)).lower(world, np.zeros(LANES, bool))
            advance = jax.jit(partial(rollouts.advance, topology))
            compiled = advance.lower(world, timing, plan, begin.out_info, np.int32(0)).compile()
            _PROGRAMS[key] = Program(begin.compile(), compiled)
        return _PROGRAMS[key]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Up to LANES worlds of one topology, in any mixture of its scenes."""

    topology: Topology
    worlds: tuple[World, ...]  # numbers of the scenes
    which: npt.NDArray[np.integer[Any]]  # (used,) index into `worlds`
    plan: npt.NDArray[np.int32]  # (used, S)
    rows: npt.NDArray[np.integer[Any]]  # (used,) the caller's rows


def _lanes(chunk: Chunk) -> npt.NDArray[np.integer[Any]]:
    """Return which of the chunk's worlds each lane plays; unused lanes repeat the last one."""
    return np.minimum(np.arange(LANES), len(chunk.which) - 1)


def _worlds(chunk: Chunk) -> World:
    """Return the numbers of the chunk's worlds with lanes behind."""
    which = chunk.which[_lanes(chunk)]
    return jax.tree.map(lambda *leaves: np.stack(leaves, -1)[..., which], *chunk.worlds)


def _plans(chunk: Chunk) -> npt.NDArray[np.int32]:
    """Return the chunk's plans with lanes behind."""
    plan = np.full((max(MAX_ELIMINABLE, chunk.plan.shape[1]), LANES), -1, np.int32)
    plan[: chunk.plan.shape[1]] = chunk.plan.T[:, _lanes(chunk)]
    return plan


def _start(
    chunk: Chunk, timing: Timing, plan: npt.NDArray[np.int32], dtype: str
) -> tuple[Program, World, rollouts.Progress]:
    """Return the program, the worlds and their start. A chunk full of one scene starts as all others of that scene."""
    key = id(chunk.worlds[chunk.which[0]]), chunk.topology
    whole = len(chunk.which) == LANES and bool(np.all(chunk.which == chunk.which[0]))
    if whole and key in _STARTS:
        return _program(chunk.topology, dtype, _STARTS[key][0], timing, plan), *_STARTS[key]
    world = jax.device_put(_worlds(chunk))
    program = _program(chunk.topology, dtype, world, timing, plan)
    progress = program.begin(world, np.arange(LANES) >= len(chunk.which))
    if whole:
        _STARTS[key] = world, progress
    return program, world, progress


def play(chunk: Chunk, timing: Timing, dtype: str, stops: Iterable[int]) -> Iterator[rollouts.Outcome]:
    """Play a chunk and yield its outcome so far, as NumPy arrays, at each of the step counts `stops`."""
    with jax.enable_x64(dtype == "float64"):
        plan = _plans(chunk)
        program, world, progress = _start(chunk, timing, plan, dtype)
        for stop in stops:
            if stop:
                progress = program.advance(world, timing, plan, progress, np.int32(stop))
            yield jax.tree.map(lambda leaf: leaf[..., : len(chunk.which)], jax.device_get(progress.outcome))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="iphyre_jax")


def run_all(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run `work` on all items, on the threads configured, and return the results in order; raise the first error."""
    pool = _pool(configuration.threads())
    return [future.result() for future in [pool.submit(work, item) for item in items]]

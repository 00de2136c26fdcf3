"""Compiled programs and the chunks of worlds that run on them.

One program per topology and dtype plays any scene of that topology at any frame rate, length and sampling: worlds run
in chunks of a fixed number of lanes. Chunks are independent, so they are handed to threads, one more than cores to use;
on a mesh there is a program for each mesh, whose chunks are larger (`meshes.Share.lanes`).
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
from jax.sharding import Mesh

from iphyre_jax import configuration, meshes, rollouts
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.scenes.build import build
from iphyre_jax.scenes.limits import MAX_ELIMINABLE
from iphyre_jax.scenes.schema import Scene

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Program:
    """Compiled `rollouts.begin` and `rollouts.advance` for chunks of one topology and dtype."""

    begin: Callable[[World, npt.NDArray[np.bool_]], rollouts.Progress]
    advance: Callable[[World, Timing, npt.NDArray[np.int32], rollouts.Progress, np.int32], rollouts.Progress]


Kind = tuple[Topology, str, int, Mesh | None]  # what is compiled anew; the number counts the columns of a plan

_LOCKS: dict[Kind, Lock] = {}
_PROGRAMS: dict[Kind, Program] = {}
# By the identity of a `World` that `built` keeps.
_STARTS: dict[tuple[int, Kind], tuple[World, rollouts.Progress]] = {}


@cache
def built(scene: Scene, resets: int, dtype: str) -> tuple[Topology, World]:
    """Return topology and numbers of a scene, computed once."""
    return build(scene, resets=resets, dtype=dtype)


def _program(kind: Kind, world: World, timing: Timing, plan: npt.NDArray[np.int32]) -> Program:
    """Return the program of a kind, compiled when first asked for; different ones compile side by side."""
    topology, *_, mesh = kind
    with _LOCKS.setdefault(kind, Lock()):
        if kind not in _PROGRAMS:
            begin, advance = partial(rollouts.begin, topology), partial(rollouts.advance, topology)
            over = np.zeros(plan.shape[1], bool)
            start = jax.eval_shape(begin, world, over)
            _PROGRAMS[kind] = Program(
                meshes.compiled(begin, mesh, world, over),
                meshes.compiled(advance, mesh, world, timing, plan, start, np.int32(0), shared=(1, 4)),
            )
        return _PROGRAMS[kind]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Worlds of one topology, in any mixture of its scenes; at most as many as there are lanes."""

    topology: Topology
    worlds: tuple[World, ...]  # numbers of the scenes
    which: npt.NDArray[np.integer[Any]]  # (used,) index into `worlds`
    plan: npt.NDArray[np.int32]  # (used, S)
    rows: npt.NDArray[np.integer[Any]]  # (used,) the caller's rows

    def filled(self, share: meshes.Share) -> npt.NDArray[np.integer[Any]]:
        """Which of the worlds each lane plays, (lanes,); unused lanes repeat the last one."""
        return np.minimum(share.rows, len(self.which) - 1)


def _worlds(chunk: Chunk, share: meshes.Share) -> World:
    """Return the numbers of the chunk's worlds with lanes behind."""
    which = chunk.which[chunk.filled(share)]
    return jax.tree.map(lambda *leaves: np.stack(leaves, -1)[..., which], *chunk.worlds)


def _plans(chunk: Chunk, share: meshes.Share) -> npt.NDArray[np.int32]:
    """Return the chunk's plans with lanes behind."""
    plan = np.full((max(MAX_ELIMINABLE, chunk.plan.shape[1]), share.lanes), -1, np.int32)
    plan[: chunk.plan.shape[1]] = chunk.plan.T[:, chunk.filled(share)]
    return plan


def _start(
    chunk: Chunk, timing: Timing, plan: npt.NDArray[np.int32], dtype: str, share: meshes.Share
) -> tuple[Program, World, rollouts.Progress]:
    """Return the program, the worlds and their start. A chunk full of one scene starts as all others of that scene."""
    columns, lanes = plan.shape
    kind = chunk.topology, dtype, columns, share.mesh
    key = id(chunk.worlds[chunk.which[0]]), kind
    whole = len(chunk.which) == lanes and bool(np.all(chunk.which == chunk.which[0]))
    if whole and key in _STARTS:
        return _PROGRAMS[kind], *_STARTS[key]
    world = meshes.put(_worlds(chunk, share), share.mesh)
    program = _program(kind, world, timing, plan)
    progress = program.begin(world, share.rows >= len(chunk.which))
    if whole:
        _STARTS[key] = world, progress
    return program, world, progress


def play(
    chunk: Chunk, timing: Timing, dtype: str, stops: Iterable[int], share: meshes.Share
) -> Iterator[rollouts.Outcome]:
    """Play a chunk and yield its outcome so far, as NumPy arrays, at each of the step counts `stops`."""
    with jax.enable_x64(dtype == "float64"):
        plan = _plans(chunk, share)
        program, world, progress = _start(chunk, timing, plan, dtype, share)
        used = share.places[: len(chunk.which)]
        for stop in stops:
            if stop:
                progress = program.advance(world, timing, plan, progress, np.int32(stop))
            yield jax.tree.map(lambda leaf: leaf[..., used], jax.device_get(progress.outcome))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """One thread more than may compute, if several do: a core then never waits while a chunk is made or collected."""
    return ThreadPoolExecutor(threads + (threads > 1), thread_name_prefix="iphyre_jax")


def run_all(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run `work` on all items, on the threads configured, and return the results in order; raise the first error."""
    pool = _pool(configuration.threads())
    return [future.result() for future in [pool.submit(work, item) for item in items]]

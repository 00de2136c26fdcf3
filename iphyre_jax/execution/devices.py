"""Devices and processes that share a batch of worlds.

On a CPU worlds run in executables from compiler processes, on threads. On an accelerator the user's JAX compiles the
programs, and `jax.shard_map` spreads the lanes of a group over the devices of a mesh. Each process plays its own whole
groups. Worlds are independent, so processes exchange nothing but the results.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
from jax.experimental import multihost_utils
from jax.sharding import Mesh, PartitionSpec

from iphyre_jax.checks import show
from iphyre_jax.execution.compilation.executables import Run, executable, run_in_jax
from iphyre_jax.execution.programs import Program, episode_layout
from iphyre_jax.physics.types import Topology

AXIS = "worlds"
LANES, FEWEST = 128, 32  # most and fewest worlds side by side on a CPU
LANES_IN_PROGRAM, FEWEST_IN_PROGRAM = 80, 48  # the same in the user's program
# The same in programs that are linked into the user's, by moving bodies: balls alone, and with bars.
LINKED_LANES = {1: (64, 64), 2: (48, 32), 3: (48, 48), 4: (16, 16)}
STATE_BYTES = 70 * 1024  # of their episodes; best with a first cache of 48 KiB, because a step does not use all of it
# On an accelerator, of plans: in large groups, and in those that fit into fewer. Measured; see "On an
# NVIDIA GPU" in docs/decisions/engine.md.
LANES_OF_DEVICE, FEWEST_OF_DEVICE = 16384, 1024
MOST_OF_DEVICE = 131072  # in the user's program, for memory's sake


@dataclass(frozen=True)
class Partition:
    """The part of the devices that belongs to this process.

    Attributes:
        mesh: its accelerators, on one axis; None for the threads of a CPU, or for JAX's default accelerator.
        process_index: of this process.
        process_count: number of processes.
    """

    mesh: Mesh | None
    process_index: int = 0
    process_count: int = 1

    def lanes(self, topology: Topology, dtype: str, worlds: int = LANES_OF_DEVICE) -> int:
        """Return how many worlds of a topology run side by side in a group of so many, or at most."""
        if on_cpu():
            return lanes_of(topology, dtype)
        devices = self.mesh.size if self.mesh else 1
        return devices * (FEWEST_OF_DEVICE if worlds <= FEWEST_OF_DEVICE * devices else LANES_OF_DEVICE)


def on_cpu() -> bool:
    """Return whether JAX's default backend is a CPU; `jax.default_device` does not count."""
    return jax.default_backend() == "cpu"


@lru_cache(1024)
def lanes_of(topology: Topology, dtype: str) -> int:
    """Return how many worlds of a topology a core plays side by side: a power of two, 32 to 128.

    Their state should stay in the core's first cache. Measured; see "Lanes" in docs/decisions/engine.md.
    """
    layout, lanes = episode_layout(topology, dtype), LANES
    while lanes > FEWEST and layout.rows * lanes * layout.word_size > STATE_BYTES:
        lanes //= 2
    return lanes


def cpu_lanes(topology: Topology, worlds: int, topologies: int) -> int:
    """Return how many worlds of a topology a CPU plays side by side in the user's program.

    Below 80, XLA's default options give scalar code: LLVM writes out copies of so few numbers one by one. From 80 on a
    lane takes as long in any group, so fewer lanes leave fewer without worlds. But where three and more bodies move and
    a topology has few worlds, half of 80 would play none. Measured; see "by its own width" in
    docs/decisions/environments.md.

    Args:
        topology: one of the batch.
        worlds: in the batch.
        topologies: in the batch.
    """
    few = topologies > 1 and worlds < LANES_IN_PROGRAM * topologies
    return FEWEST_IN_PROGRAM if few and topology.moving > 2 else LANES_IN_PROGRAM


def linked_lanes(topology: Topology) -> int:
    """Return how many worlds of a topology are side by side in a program that is linked into the user's.

    The fewer, the less do groups wait for their slowest world, and the fewer lanes of small batches play none.
    Measured; see "linked into the user's" in docs/decisions/environments.md.
    """
    return LINKED_LANES[min(topology.moving, max(LINKED_LANES))][topology.bars > 0]


def accelerator_lanes(worlds: int, topologies: int) -> int:
    """Return how many of so many worlds run side by side in the user's program on an accelerator.

    It takes as long for few as for thousands. So a topology has one group, even if its share is double. On an NVIDIA
    GPU this is for one topology, and where no kernel of several can be made.
    """
    return min(worlds, MOST_OF_DEVICE, max(FEWEST_OF_DEVICE, 2 * worlds // topologies))


def partition_of(mesh: Mesh | None) -> Partition:
    """Return this process's part of a mesh with any axes.

    Raises:
        ValueError: it is not a mesh, or has devices of some processes but not of others; one line.
    """
    if mesh is None:
        return Partition(None)
    if not isinstance(mesh, Mesh):
        raise ValueError(f"mesh: expected a jax.sharding.Mesh, from jax.make_mesh, or None, got {show(mesh)}")
    processes = {device.process_index for device in mesh.devices.flat}
    process_index, process_count = jax.process_index(), jax.process_count()
    if processes not in ({process_index}, set(range(process_count))):
        raise ValueError(
            f"mesh: expected devices of this process alone or of all {process_count}, got {sorted(processes)}"
        )
    own = None
    if not on_cpu():
        own = Mesh(np.array([device for device in mesh.devices.flat if device.process_index == process_index]), AXIS)
    return Partition(own) if processes == {process_index} else Partition(own, process_index, process_count)


def runner(program: Program, mesh: Mesh | None) -> Run:
    """Return a program as a function of NumPy arrays, on this process's CPU or its accelerators."""
    return executable(program) if on_cpu() else _on_accelerators(program, mesh)


@lru_cache(256)
def _on_accelerators(program: Program, mesh: Mesh | None) -> Run:
    """Return a program compiled by the user's JAX; on a mesh each device plays its own lanes until they are done."""
    run = program.run
    if mesh is not None:
        with jax.enable_x64(program.dtype == "float64"):
            results = jax.eval_shape(program.run, *program.arguments())
        inside = tuple(map(partial(_spec, program.lanes), program.arguments()))
        outside = tuple(map(partial(_spec, program.lanes), results))
        run = jax.shard_map(program.run, mesh=mesh, in_specs=inside, out_specs=outside, check_vma=False)
    return run_in_jax(run, program.dtype)


def _spec(lanes: int, shape: jax.ShapeDtypeStruct) -> PartitionSpec:
    """Return how an array is spread: along its last axis if that is lanes."""
    if shape.shape and shape.shape[-1] == lanes:
        return PartitionSpec(*[None] * (len(shape.shape) - 1), AXIS)
    return PartitionSpec()


def check_same_call(*call: object) -> None:
    """Check that all processes make the same call.

    Args:
        call: arrays, and values that equal `repr`s make equal.

    Raises:
        ValueError: they do not; one line, in every process.
    """
    digest = hashlib.sha256()
    for part in call:
        digest.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
    gathered = multihost_utils.process_allgather(np.frombuffer(digest.digest(), np.uint8))
    if (gathered != gathered[0]).any():
        raise ValueError("mesh: it spans processes, which must all make the same call with the same arguments")


def gather(partition: Partition, rows: Sequence[npt.NDArray[np.integer[Any]]], array: npt.NDArray[Any]) -> None:
    """Write the rows of the other processes into an array, in every process.

    Args:
        partition: of this process.
        rows: of each process, the rows that it has written.
        array: (B, ...), of any type.
    """
    own = np.zeros((max(map(len, rows)), *array.shape[1:]), array.dtype)
    own[: len(rows[partition.process_index])] = array[rows[partition.process_index]]
    with jax.enable_x64(True):
        gathered = multihost_utils.process_allgather(own)
    for process_index, theirs in enumerate(rows):
        array[theirs] = gathered[process_index, : len(theirs)]

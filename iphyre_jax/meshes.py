"""Several devices, of this process and of others, for one batch of worlds.

Within a process the lanes of a chunk are spread over its devices by `jax.shard_map`. Between processes whole chunks are
dealt out, and nothing is exchanged before the results are gathered: worlds need nothing of each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np
import numpy.typing as npt
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "worlds"
LANES = 128  # worlds a chunk on a CPU: their state stays in the cache of a core
LANES_OF_DEVICE = 8192  # on an accelerator, which wants many at once; never measured

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class Share:
    """What this process has of the devices that play.

    Attributes:
        mesh: its own devices, on one axis; None for JAX's default device.
        rank: its place among the processes.
        ranks: number of processes.
    """

    mesh: Mesh | None
    rank: int = 0
    ranks: int = 1

    @property
    def lanes(self) -> int:
        """Worlds in a chunk."""
        return most_lanes() * (self.mesh.size if self.mesh else 1)


def most_lanes() -> int:
    """Return how many worlds a chunk has at most on one device."""
    return LANES if jax.default_backend() == "cpu" else LANES_OF_DEVICE


def share_of(mesh: Mesh | None) -> Share:
    """Return this process's share of a mesh of any axes.

    Raises:
        ValueError: it is no mesh, or has devices of some processes and not of others; one line.
    """
    if mesh is None:
        return Share(None)
    if not isinstance(mesh, Mesh):
        raise ValueError(f"mesh: expected a jax.sharding.Mesh, as of jax.make_mesh, or None, got {mesh!r}")
    processes = {device.process_index for device in mesh.devices.flat}
    rank, ranks = jax.process_index(), jax.process_count()
    if processes not in ({rank}, set(range(ranks))):
        raise ValueError(f"mesh: expected devices of this process alone or of all {ranks}, got {sorted(processes)}")
    own = Mesh(np.array([device for device in mesh.devices.flat if device.process_index == rank]), AXIS)
    return Share(own) if processes == {rank} else Share(own, rank, ranks)


def _lanes_apart(tree: Any) -> Any:  # noqa: ANN401 - any tree of arrays
    """Say for each array that its last axis is lanes, to be spread over the devices."""
    return jax.tree.map(lambda leaf: PartitionSpec(*[None] * (leaf.ndim - 1), AXIS), tree)


def put(tree: Tree, mesh: Mesh | None) -> Tree:
    """Send arrays to the device, or their lanes to the devices."""
    if mesh is None:
        return jax.device_put(tree)
    return jax.device_put(tree, jax.tree.map(partial(NamedSharding, mesh), _lanes_apart(tree)))


def compiled(
    function: Callable[..., Any],
    mesh: Mesh | None,
    *arguments: Any,  # noqa: ANN401 - trees of arrays
    shared: Sequence[int] = (),
) -> jax.stages.Compiled:
    """Compile a function whose arguments and results have lanes; on a mesh each device plays its own.

    A loop then ends on a device when its own lanes are over; a program split by the compiler would have the devices
    agree on it at each step.

    Args:
        function: of arrays.
        mesh: devices, or None for the default one.
        arguments: as the function will get them, or their shapes.
        shared: places of the arguments that have no lanes and are the same for all devices.
    """
    if mesh is None:
        return jax.jit(function).lower(*arguments).compile()
    inside = tuple(PartitionSpec() if k in shared else _lanes_apart(part) for k, part in enumerate(arguments))
    outside = _lanes_apart(jax.eval_shape(function, *arguments))
    spread = jax.shard_map(function, mesh=mesh, in_specs=inside, out_specs=outside, check_vma=False)
    given, made = jax.tree.map(partial(NamedSharding, mesh), (inside, outside))
    return jax.jit(spread, in_shardings=given, out_shardings=made).lower(*arguments).compile()


def agree(*call: object) -> None:
    """Make sure that all processes have made the same call.

    Args:
        call: arrays, and values whose `repr` tells all.

    Raises:
        ValueError: they have not; one line, in every process.
    """
    digest = hashlib.sha256()
    for part in call:
        digest.update(part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode())
    told = multihost_utils.process_allgather(np.frombuffer(digest.digest(), np.uint8))
    if (told != told[0]).any():
        raise ValueError("mesh: it spans processes, which must all make the same call with the same arguments")


def gather(share: Share, rows: Sequence[npt.NDArray[np.integer[Any]]], array: npt.NDArray[Any]) -> None:
    """Fill up an array, in every process, with the rows that the others have written.

    Args:
        share: what this process has.
        rows: for each rank, the rows that are its own.
        array: (B, ...), of any type.
    """
    own = np.zeros((max(map(len, rows)), *array.shape[1:]), array.dtype)
    own[: len(rows[share.rank])] = array[rows[share.rank]]
    with jax.enable_x64(True):
        told = multihost_utils.process_allgather(own)
    for rank, theirs in enumerate(rows):
        array[theirs] = told[rank, : len(theirs)]

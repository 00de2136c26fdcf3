"""Several devices, of this process and of others, for one batch of worlds.

Within a process the lanes of a chunk are spread over its devices by `jax.shard_map`; a device plays its own in turns,
for the devices wait for each other at the end of a call. Between processes whole chunks are dealt out, and nothing is
exchanged before the results are gathered: worlds need nothing of each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

AXIS = "worlds"
LANES = 128  # worlds side by side on a CPU: their state stays in the cache of a core
TURNS = 4  # such groups one after the other in a call, on each of several CPU devices: their times differ, sums less
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
        return most_lanes() * _turns(self.mesh) * _devices(self.mesh)

    @cached_property
    def rows(self) -> npt.NDArray[np.int64]:
        """Which of a chunk's worlds each lane plays, (lanes,): turn by turn, or one device would get all long ones."""
        return np.arange(self.lanes).reshape(_turns(self.mesh), _devices(self.mesh), -1).swapaxes(0, 1).ravel()

    @cached_property
    def places(self) -> npt.NDArray[np.int64]:
        """Which lane plays each of a chunk's worlds, (lanes,)."""
        return np.argsort(self.rows)


def _devices(mesh: Mesh | None) -> int:
    return mesh.size if mesh else 1


def _turns(mesh: Mesh | None) -> int:
    """Return how many groups of lanes each device plays in a call."""
    return TURNS if _devices(mesh) > 1 and jax.default_backend() == "cpu" else 1


def most_lanes() -> int:
    """Return how many worlds a device plays side by side."""
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
    played = _in_turns(function, _turns(mesh), shared)
    inside = tuple(PartitionSpec() if k in shared else _lanes_apart(part) for k, part in enumerate(arguments))
    outside = _lanes_apart(jax.eval_shape(played, *arguments))
    spread = jax.shard_map(played, mesh=mesh, in_specs=inside, out_specs=outside, check_vma=False)
    given, made = jax.tree.map(partial(NamedSharding, mesh), (inside, outside))
    return jax.jit(spread, in_shardings=given, out_shardings=made).lower(*arguments).compile()


def _in_turns(function: Callable[..., Any], turns: int, shared: Sequence[int]) -> Callable[..., Any]:
    """Make a function of so many groups of lanes, one behind the other, of one of a single group."""
    if turns == 1:
        return function

    def apart(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], turns, leaf.shape[-1] // turns), -2, 0)

    def together(leaf: jax.Array) -> jax.Array:
        leaf = jnp.moveaxis(leaf, 0, -2)
        return leaf.reshape(*leaf.shape[:-2], leaf.shape[-2] * leaf.shape[-1])

    def played(*arguments: Any) -> Any:  # noqa: ANN401 - trees of arrays
        own = {k: jax.tree.map(apart, part) for k, part in enumerate(arguments) if k not in shared}

        def one(turn: Mapping[int, Any]) -> Any:  # noqa: ANN401
            return function(*(turn.get(k, part) for k, part in enumerate(arguments)))

        return jax.tree.map(together, jax.lax.map(one, own))

    return played


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

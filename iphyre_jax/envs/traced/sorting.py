"""Sort a batch of worlds, one a row, into groups of lanes of one topology each, and play them by its branch; traced.

The same grouping outside a traced program is `execution.batching`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

# branch(given, out, first) plays `given`, one world a row, and returns `out` with the results from row `first` on.
Branch = Callable[[Any, Any, jax.Array], Any]
_LARGEST = np.iinfo(np.int32).max


def run_slices(branch: Branch, lanes: int, given: Any, out: Any) -> Any:  # noqa: ANN401 - trees of arrays
    """Play a batch of worlds of one topology, slice by slice of lanes, and return `out` with its results."""
    size = jax.tree.leaves(given)[0].shape[0]

    def run_slice(k: jax.Array, out: Any) -> Any:  # noqa: ANN401
        # The last slice plays some worlds of the one before again.
        start = jnp.minimum(k * lanes, size - lanes).astype(jnp.int32)
        part = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, lanes), given)
        return branch(part, out, start)

    return jax.lax.fori_loop(0, -(-size // lanes), run_slice, out)


def run_sorted(
    branches: Sequence[Branch],
    lanes: int,
    topology_id: jax.Array,
    given: Any,  # noqa: ANN401
    out: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Play a batch of worlds of several topologies, sorted into groups of one; return `out` with its results."""
    groups = _Groups.of(topology_id, len(branches), lanes)
    blank = jax.tree.map(lambda leaf: jnp.zeros((lanes, *leaf.shape[1:]), leaf.dtype), out)

    def run_group(k: jax.Array, out: Any) -> Any:  # noqa: ANN401
        topology_id, read, rows = groups.at(k)
        part = jax.tree.map(lambda leaf: leaf.at[read].get(mode="promise_in_bounds"), given)
        after = jax.lax.switch(topology_id, branches, part, blank, jnp.int32(0))
        return jax.tree.map(
            lambda leaf, new: leaf.at[rows].set(new, mode="drop", unique_indices=True, indices_are_sorted=True),
            out,
            after,
        )

    return jax.lax.fori_loop(0, groups.count, run_group, out)


def one_game(games: int, topologies: int) -> bool:
    """Return whether all worlds certainly play one game, of the one topology."""
    return games == topologies == 1


def sort_by_game(topology_id: jax.Array, row: jax.Array, topologies: int) -> tuple[jax.Array, jax.Array]:
    """Return worlds in the order of their topologies, and within one of their games, (B,) int32.

    If an int32 cannot hold topology, game and world, the worlds of one topology are in any order.

    Args:
        topology_id: (games,) int32, of each game.
        row: (B,) int32, game of each world.
        topologies: so many.

    Returns:
        The order, and for each topology the place after its last world, (topologies,) int32.
    """
    games, worlds = topology_id.shape[0], row.shape[0]
    if one_game(games, topologies):
        return jnp.arange(worlds, dtype=jnp.int32), jnp.full(1, worlds, jnp.int32)
    own = topology_id[row]
    keys = own * games + row if topologies * games * worlds <= _LARGEST else own
    return _order(keys), jnp.cumsum(_sizes(own, topologies), dtype=jnp.int32)


class Sorted(NamedTuple):
    """A batch of worlds in blocks of one topology each."""

    topology_id: jax.Array  # (blocks,) int32
    read: jax.Array  # (blocks * lanes,) int32, the world that each lane plays
    place: jax.Array  # (B,) int32, the lane that plays each world


def sort_into_blocks(topology_id: jax.Array, topologies: int, lanes: int) -> Sorted:
    """Return worlds with given topologies, (B,), in blocks of so many lanes; the shapes alone say how many blocks.

    Spare lanes play a world of their block again, and spare blocks are the last one again.
    """
    worlds = topology_id.shape[0]
    blocks = worlds // lanes + min(topologies, worlds)  # as many as there may be
    groups = _Groups.of(topology_id, topologies, lanes)
    number = jnp.arange(blocks, dtype=jnp.int32)
    chosen, read, rows = jax.vmap(groups.at)(jnp.minimum(number, groups.count - 1))
    lane = jnp.arange(blocks * lanes, dtype=jnp.int32)
    place = jnp.zeros(worlds, jnp.int32).at[rows.reshape(-1)].max(lane, mode="drop")
    return Sorted(chosen, read.reshape(-1), place)


@dataclass(frozen=True)
class _Groups:
    """The worlds of a batch in groups of one topology each."""

    order: jax.Array  # (B,) int32, the worlds sorted by topology
    size: jax.Array  # (topologies,) int32, worlds of each
    before: jax.Array  # (topologies,) int32, worlds of the topologies before it
    last: jax.Array  # (topologies,) int32, groups up to the last of a topology, included
    lanes: int

    @classmethod
    def of(cls, topology_id: jax.Array, topologies: int, lanes: int) -> _Groups:
        """Return the groups of worlds with given topologies, (B,)."""
        size = _sizes(topology_id, topologies)
        total = jnp.cumsum(size, dtype=jnp.int32)
        return cls(_order(topology_id), size, total - size, jnp.cumsum(-(-size // lanes), dtype=jnp.int32), lanes)

    @property
    def count(self) -> jax.Array:
        """The number of groups, () int32."""
        return self.last[-1]

    def at(self, k: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the topology of group k, the worlds that its lanes play, and where their results go, (lanes,) int32.

        Spare lanes play the last world of the topology too. Their results go beyond the batch. Rows of results rise.
        """
        topology_id = jnp.sum((k >= self.last).astype(jnp.int32), dtype=jnp.int32)
        size, start = self.size[topology_id], self.before[topology_id]
        own_groups = -(-size // self.lanes)
        offset = (k - self.last[topology_id] + own_groups) * self.lanes + jnp.arange(self.lanes, dtype=jnp.int32)
        read = self.order.at[start + jnp.minimum(offset, size - 1)].get(mode="promise_in_bounds")
        return topology_id, read, jnp.where(offset < size, read, self.order.shape[0] + offset)


def _sizes(topology_id: jax.Array, topologies: int) -> jax.Array:
    """Return how many worlds each topology has, (topologies,) int32; topology_id: (B,) of each world."""
    return jnp.stack([jnp.sum(topology_id == k, dtype=jnp.int32) for k in range(topologies)])


def _order(keys: jax.Array) -> jax.Array:
    """Return indices that sort keys, (B,) int32, not negative; the largest key times B must be an int32.

    A CPU sorts numbers ten times as fast as pairs, so the index is the lower part of a number.
    """
    size = keys.shape[0]
    return jnp.sort(keys * size + jnp.arange(size, dtype=jnp.int32), stable=False) % size

"""Play a batch of worlds (leading axis) in groups of lanes, each by the branch of its topology; traced.

The same grouping outside a traced program is `execution.batching`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.envs.batching.play_requests import PlayRequest
from iphyre_jax.rollouts import EpisodeState

Tree = TypeVar("Tree")
Branch = Callable[[PlayRequest, EpisodeState], EpisodeState]


def run_slices(branch: Branch, lanes: int, request: PlayRequest, episode: EpisodeState) -> EpisodeState:
    """Play a batch of worlds of one topology, slice by slice of lanes."""
    size = request.game.shape[0]
    if size == lanes:
        return _as_batch(branch(*_as_lanes((request, episode))))

    def run_slice(k: jax.Array, whole: EpisodeState) -> EpisodeState:
        start = jnp.minimum(k * lanes, size - lanes)  # worlds that the last slice plays again wait
        part = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, lanes), (request, whole))
        after = _as_batch(branch(*_as_lanes(part)))
        return jax.tree.map(lambda leaf, new: jax.lax.dynamic_update_slice_in_dim(leaf, new, start, 0), whole, after)

    return jax.lax.fori_loop(0, -(-size // lanes), run_slice, episode)


def run_sorted(
    branches: Sequence[Branch], lanes: int, topology_id: jax.Array, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Play a batch of worlds of several topologies, sorted into groups of one topology each."""
    size = request.game.shape[0]
    groups = _Groups.of(topology_id, len(branches), lanes)

    def run_group(k: jax.Array, whole: EpisodeState) -> EpisodeState:
        topology_id, rows = groups.at(k)
        part, before = jax.tree.map(lambda leaf: leaf.at[rows].get(mode="clip"), (request, whole))
        part = replace(part, stop_step=jnp.where(rows < size, part.stop_step, 0))  # a spare lane waits from the start
        after = _as_batch(jax.lax.switch(topology_id, branches, *_as_lanes((part, before))))
        return jax.tree.map(
            lambda leaf, new: leaf.at[rows].set(new, mode="drop", unique_indices=True, indices_are_sorted=True),
            whole,
            after,
        )

    return jax.lax.fori_loop(0, groups.count, run_group, episode)


def _as_lanes(tree: Tree) -> Tree:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1), tree)


def _as_batch(tree: Tree) -> Tree:
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), tree)


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
        order = jnp.arange(topology_id.shape[0], dtype=jnp.int32)
        if topologies > 1:
            order = jnp.argsort(topology_id, stable=True).astype(jnp.int32)
        size = jnp.stack([jnp.sum(topology_id == k, dtype=jnp.int32) for k in range(topologies)])
        total = jnp.cumsum(size, dtype=jnp.int32)
        return cls(order, size, total - size, jnp.cumsum(-(-size // lanes), dtype=jnp.int32), lanes)

    @property
    def count(self) -> jax.Array:
        """The number of groups, () int32."""
        return self.last[-1]

    def at(self, k: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the topology of group k and its worlds, (lanes,) int32, rising; spare lanes lie beyond the batch."""
        topology_id = jnp.sum((k >= self.last).astype(jnp.int32), dtype=jnp.int32)
        own_groups = -(-self.size[topology_id] // self.lanes)
        offset = (k - self.last[topology_id] + own_groups) * self.lanes + jnp.arange(self.lanes, dtype=jnp.int32)
        rows = self.order.at[self.before[topology_id] + offset].get(mode="clip")
        return topology_id, jnp.where(offset < self.size[topology_id], rows, self.order.shape[0] + offset)

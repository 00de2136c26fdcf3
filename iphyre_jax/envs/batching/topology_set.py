"""Worlds of several topologies in one program.

A topology decides what is compiled, so a batch that mixes games needs one program for each of them, and arrays of one
shape for all. `TopologySet` gives both: every array of a world is filled up with rows at its end to the largest of the
mixture; `run` cuts off the rows that are not the world's own, runs its topology's program and fills up again. So each
world is computed as it would be in a batch of its own kind.

`run` is written for one world. Under `jax.vmap`, nested or not, it does not become "play every topology for every
world and select": the worlds are sorted by topology and played in chunks of lanes (trailing axes, see `physics.types`),
each chunk by the program of its own topology.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from iphyre_jax.envs.batching.padded_shapes import PaddedShapes
from iphyre_jax.envs.batching.play_requests import PlayRequest, initial_episode, run_requests
from iphyre_jax.envs.batching.sorting import run_slices, run_sorted
from iphyre_jax.execution.devices import traced_lanes
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState

Run = Callable[[Timing, "Games", PlayRequest, EpisodeState], EpisodeState]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Games:
    """A table of worlds, filled up, one a row of every array."""

    world: World
    topology_id: jax.Array  # (games,) int32, index into the mixture's topologies


@dataclass(frozen=True)
class TopologySet:
    """The topologies that one program plays; hashable, hence static under `jax.jit`.

    Attributes:
        topologies: in the order in which `Games.topology_id` counts them.
        worlds: shapes of a world of each.
        episodes: shapes of its progress.
    """

    topologies: tuple[Topology, ...]
    worlds: tuple[PaddedShapes, ...]
    episodes: tuple[PaddedShapes, ...]

    @classmethod
    @cache
    def of(cls, topologies: tuple[Topology, ...], dtype: str) -> TopologySet:
        """Return the mixture of some topologies, at least one; dtype: of the physics."""
        with jax.enable_x64(dtype == "float64"):
            worlds = [World.shapes(topology, dtype) for topology in topologies]
            starts = [
                jax.eval_shape(partial(initial_episode, t), world) for t, world in zip(topologies, worlds, strict=True)
            ]
        return cls(topologies, tuple(map(PaddedShapes.of, worlds)), tuple(map(PaddedShapes.of, starts)))

    def only(self, topology_id: int) -> TopologySet:
        """Return the mixture of one of the topologies."""
        return TopologySet((self.topologies[topology_id],), (self.worlds[topology_id],), (self.episodes[topology_id],))

    @property
    def world(self) -> PaddedShapes:
        """The shapes of a world filled up."""
        return PaddedShapes.largest(self.worlds)

    @property
    def episode(self) -> PaddedShapes:
        """The shapes of a progress filled up."""
        return PaddedShapes.largest(self.episodes)

    def run(self, timing: Timing, games: Games, request: PlayRequest, episode: EpisodeState) -> EpisodeState:
        """Play one world until `request.stop_step` steps are made or its episode is done; one that is done stays.

        Args:
            timing: of the physics step; not to be mapped over.
            games: the table.
            request: of one world.
            episode: of the world, filled up.
        """
        return _vmappable(self)(timing, games, request, episode)


@cache
def _vmappable(topology_set: TopologySet) -> Run:
    """Return `run` of a mixture, which takes one world or a batch of them on a leading axis."""
    run = custom_vmap(jax.jit(partial(_run, topology_set)))

    @run.def_vmap
    def batched(
        size: int, mapped: Sequence[object], timing: Timing, games: Games, request: PlayRequest, episode: EpisodeState
    ) -> tuple[EpisodeState, EpisodeState]:
        if any(jax.tree.leaves(mapped[0])):
            raise ValueError("timing: expected the same for all worlds of a batch, got one that is mapped over")

        def with_axis(leaf: jax.Array, has_axis: bool) -> jax.Array:
            return leaf if has_axis else jnp.broadcast_to(leaf, (size, *leaf.shape))

        request, episode = jax.tree.map(with_axis, (request, episode), tuple(mapped[2:]))
        if any(jax.tree.leaves(mapped[1])):  # a table for each: one below the other
            games = jax.tree.map(with_axis, games, mapped[1])
            each = games.topology_id.shape[1]
            games = jax.tree.map(lambda leaf: leaf.reshape(size * each, *leaf.shape[2:]), games)
            first = each * jnp.arange(size, dtype=jnp.int32)
            request = replace(request, game=request.game + first.reshape(size, *(1,) * (request.game.ndim - 1)))
        batch = request.game.shape
        count = math.prod(batch)
        flat = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[len(batch) :]), (request, episode))
        out = jax.tree.map(lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), run(timing, games, *flat))
        return out, jax.tree.map(lambda _: True, out)

    return run


def _run(
    topology_set: TopologySet, timing: Timing, games: Games, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Play one world, or a batch on the leading axis."""
    branches = [
        partial(_run_topology, topology_set, topology_id, timing, games.world)
        for topology_id in range(len(topology_set.topologies))
    ]
    if request.game.ndim == 0:
        return jax.lax.switch(games.topology_id[request.game], branches, request, episode)
    size = request.game.shape[0]
    lanes = min(size, traced_lanes())
    if len(branches) == 1:
        return run_slices(branches[0], lanes, request, episode)
    return run_sorted(branches, lanes, games.topology_id[request.game], request, episode)


def _run_topology(
    topology_set: TopologySet,
    topology_id: int,
    timing: Timing,
    worlds: World,
    request: PlayRequest,
    episode: EpisodeState,
) -> EpisodeState:
    """Play worlds, lanes behind their rows, that all are of one topology of the mixture."""
    own = topology_set.worlds[topology_id]
    one = jax.tree.leaves(worlds)[0].shape[0] == 1

    def in_lanes(leaf: jax.Array) -> jax.Array:
        if one:  # nothing to look up, and the same number in all lanes
            rows = leaf[0].reshape(*leaf.shape[1:], *(1,) * request.game.ndim)
            return jnp.broadcast_to(rows, (*leaf.shape[1:], *request.game.shape))
        return jnp.moveaxis(leaf[request.game], 0, -1) if request.game.ndim else leaf[request.game]

    world = own.unpad(jax.tree.map(in_lanes, worlds))
    after = run_requests(
        topology_set.topologies[topology_id], timing, world, request, topology_set.episodes[topology_id].unpad(episode)
    )
    return topology_set.episode.pad(after)

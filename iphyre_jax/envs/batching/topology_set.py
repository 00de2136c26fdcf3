"""Worlds of several topologies in one program.

A topology decides what is compiled. So a batch that mixes games needs one program for each topology, and arrays of one
shape for all of them. `TopologySet` gives both: every array of a world is padded at its end to the largest shape; `run`
cuts the padding off, runs the program of the world's topology and pads the result. So each world is computed as in a
batch of its own topology.

`run` is written for one world. Under `jax.vmap`, nested or not, it does not play every topology for every world and
select one. It sorts the worlds by topology and plays groups of lanes (trailing axes, see `physics.types`), each group
by the program of its topology.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

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
    """The worlds of all games, padded, one a row of every array."""

    world: World
    topology_id: jax.Array  # (games,) int32, index into the set's topologies


@dataclass(frozen=True)
class TopologySet:
    """The topologies that one program plays; hashable, hence static under `jax.jit`.

    Attributes:
        topologies: `Games.topology_id` is an index into them.
        worlds: shapes of a world of each topology.
        episodes: shapes of an episode of each topology.
    """

    topologies: tuple[Topology, ...]
    worlds: tuple[PaddedShapes, ...]
    episodes: tuple[PaddedShapes, ...]

    @classmethod
    @lru_cache(64)
    def of(cls, topologies: tuple[Topology, ...], dtype: str) -> TopologySet:
        """Return the set of some topologies, at least one; dtype: of the physics."""
        with jax.enable_x64(dtype == "float64"):
            worlds = [World.shapes(topology, dtype) for topology in topologies]
            episodes = [jax.eval_shape(partial(initial_episode, t), w) for t, w in zip(topologies, worlds, strict=True)]
        return cls(topologies, tuple(map(PaddedShapes.of, worlds)), tuple(map(PaddedShapes.of, episodes)))

    @property
    def world(self) -> PaddedShapes:
        """The shapes of a padded world."""
        return PaddedShapes.largest(self.worlds)

    @property
    def episode(self) -> PaddedShapes:
        """The shapes of a padded episode."""
        return PaddedShapes.largest(self.episodes)

    def run(self, timing: Timing, games: Games, request: PlayRequest, episode: EpisodeState) -> EpisodeState:
        """Play one world until `request.stop_step` steps are made or its episode is done.

        Args:
            timing: of the physics step; the same for all worlds of a batch.
            games: the worlds of all games.
            request: of one world.
            episode: of the world, padded; one that is done stays as it is.
        """
        return _vmappable(self)(timing, games, request, episode)


@lru_cache(64)
def _vmappable(topology_set: TopologySet) -> Run:
    """Return `TopologySet.run` with its own rule for `jax.vmap`."""
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
        if any(jax.tree.leaves(mapped[1])):  # each world has games of its own: stack them
            games = jax.tree.map(with_axis, games, mapped[1])
            per_world = games.topology_id.shape[1]
            games = jax.tree.map(lambda leaf: leaf.reshape(size * per_world, *leaf.shape[2:]), games)
            first = per_world * jnp.arange(size, dtype=jnp.int32)
            request = replace(request, game=request.game + first.reshape(size, *(1,) * (request.game.ndim - 1)))
        batch = request.game.shape
        count = math.prod(batch)
        flat = jax.tree.map(lambda leaf: leaf.reshape(count, *leaf.shape[len(batch) :]), (request, episode))
        out = jax.tree.map(lambda leaf: leaf.reshape(*batch, *leaf.shape[1:]), run(timing, games, *flat))
        return out, jax.tree.map(lambda _: True, out)

    return run


def _run(one: TopologySet, timing: Timing, games: Games, request: PlayRequest, episode: EpisodeState) -> EpisodeState:
    """Play one world, or a batch on the leading axis."""
    branches = [partial(_run_topology, one, k, timing, games.world) for k in range(len(one.topologies))]
    if request.game.ndim == 0:
        return jax.lax.switch(games.topology_id[request.game], branches, request, episode)
    lanes = min(request.game.shape[0], traced_lanes())
    if len(branches) == 1:
        return run_slices(branches[0], lanes, request, episode)
    return run_sorted(branches, lanes, games.topology_id[request.game], request, episode)


def _run_topology(
    one: TopologySet, topology_id: int, timing: Timing, worlds: World, request: PlayRequest, episode: EpisodeState
) -> EpisodeState:
    """Play worlds of one topology, lanes behind their rows."""
    is_single = jax.tree.leaves(worlds)[0].shape[0] == 1

    def in_lanes(leaf: jax.Array) -> jax.Array:
        if is_single:  # no lookup: all lanes play the one game
            rows = leaf[0].reshape(*leaf.shape[1:], *(1,) * request.game.ndim)
            return jnp.broadcast_to(rows, (*leaf.shape[1:], *request.game.shape))
        return jnp.moveaxis(leaf[request.game], 0, -1) if request.game.ndim else leaf[request.game]

    world = one.worlds[topology_id].unpad(jax.tree.map(in_lanes, worlds))
    own = one.episodes[topology_id].unpad(episode)
    return one.episode.pad(run_requests(one.topologies[topology_id], timing, world, request, own))

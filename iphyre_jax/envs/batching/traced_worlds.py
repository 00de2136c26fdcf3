"""Worlds inside the user's own program: for accelerators, for gradients, and wherever the host must not be called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.batching.play_requests import PlayRequest, start
from iphyre_jax.envs.batching.status import Status, status_of
from iphyre_jax.envs.batching.topology_set import Games, Mixture
from iphyre_jax.envs.params import EnvParams, EnvState, Played, Worlds
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.observations.features import Features, Pose, own_features, pose_of, scene_tables
from iphyre_jax.observations.vectors import observe
from iphyre_jax.physics.types import World
from iphyre_jax.rollouts import EpisodeState
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedParams(EnvParams):
    """Games as arrays, each filled up to the largest."""

    table: Games  # as the solver reads them
    start: EpisodeState  # before the first step
    features: Features  # what an observation needs

    @property
    def games(self) -> int:
        """The number of games."""
        return self.table.kind.shape[-1]

    @property
    def kind(self) -> jax.Array:
        """Topology of each game."""
        return self.table.kind

    @property
    def world(self) -> World:
        """The games as worlds of the solver."""
        return self.table.world


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedState(EnvState):
    """An episode as the solver has it, filled up to the largest."""

    episode: EpisodeState  # of the physics
    row: jax.Array  # () int32, row of the parameters
    executed: jax.Array  # (slots,) bool, slots that a combined plan has executed

    @property
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""
        return self.row


@dataclass(frozen=True)
class TracedWorlds(Worlds):
    """Worlds of some topologies, see `params.Worlds`."""

    @property
    def mixture(self) -> Mixture:
        """The topologies as one program."""
        return Mixture.of(self.topologies, self.dtype)

    def params(self, scenes: Sequence[Scene]) -> TracedParams:
        """Return scenes as parameters."""
        mixture = self.mixture
        kinds, rows = [], []
        with jax.enable_x64(self.dtype == "float64"):
            for scene in scenes:
                topology, world = cached_world(scene, self.protocol.resets, self.dtype)
                kinds.append(self.topologies.index(topology))
                rows.append((mixture.world.fill(world), mixture.episode.fill(start(topology, world))))
            world, episode = _table(rows)
            features = _table([scene_tables(scene, self.topologies, self.dtype) for scene in scenes])
            return TracedParams(Games(world, jnp.asarray(kinds, jnp.int32)), episode, features)

    def alone(self, params: TracedParams, game: int) -> TracedParams:
        """Return the parameters of one game, for worlds of its topology alone (host)."""
        kind = int(params.table.kind[game])
        of = self.mixture.only(kind)
        with jax.enable_x64(self.dtype == "float64"):
            tables = params.world, params.start, params.features
            world, begun, features = jax.tree.map(lambda leaf: np.asarray(leaf)[game], tables)
            own = of.world.cut(world), of.episode.cut(begun), own_features(features, self.topologies[kind])
            world, begun, features = jax.tree.map(lambda leaf: jnp.asarray(leaf[None]), own)
            return TracedParams(Games(world, jnp.zeros(1, jnp.int32)), begun, features)

    def begin(self, params: TracedParams, game: jax.Array) -> tuple[jax.Array, TracedState]:
        """Return what is seen, and the state, of an episode before its first step."""
        row = jnp.asarray(game, jnp.int32)
        state = TracedState(_row(params.start, row), row, jnp.zeros(self.limits.blocks, bool))
        return self.observe(params, state), state

    def play(
        self,
        params: TracedParams,
        state: TracedState,
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: jax.Array,
    ) -> Played:
        """Play on; see `params.Worlds`."""
        times, games = _opaque((step_timing(self.protocol.fps, self.dtype), params.table))
        episode = self.mixture.play(times, games, PlayRequest(state.row, plan, stop_step), state.episode)
        last = TracedState(episode, state.row, executed)
        status, last_seen = self.status(params, last), self.observe(params, last)
        ended = status.success | (status.fault != 0) | (status.step >= self.protocol.steps)
        follows = ended & (next_game >= 0)
        fresh = self.begin(params, jnp.maximum(next_game, 0))
        seen, now = jax.tree.map(lambda new, old: jnp.where(follows, new, old), fresh, (last_seen, last))
        return Played(now, seen, status, last, last_seen)

    def status(self, params: TracedParams, state: TracedState) -> Status:
        """Return the status of an episode."""
        return status_of(state.row, _row(params.world, state.row), state.episode, state.executed)

    def observe(self, params: TracedParams, state: TracedState) -> jax.Array:
        """Return what is seen of an episode."""
        present, steps = self.status(params, state).present, jnp.asarray(self.protocol.steps)
        features = _row(params.features, state.row)
        return jnp.concatenate(observe(self.observation, features, present, state.episode, steps, no_op=self.no_op))

    def pose(self, params: TracedParams, state: TracedState) -> tuple[Features, Pose]:
        """Return what a picture of an episode needs."""
        features = _row(params.features, state.row)
        return features, pose_of(features, self.status(params, state).present, state.episode)


def _table(rows: Sequence[Tree]) -> Tree:
    """Stack trees of arrays row by row, on the device."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *rows)


def _row(table: Tree, index: jax.Array) -> Tree:
    """Return one row of every array of a tree."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], table)


def _opaque(tree: Tree) -> Tree:
    """Return arrays out of the compiler's sight: what it does with constants rounds otherwise."""
    return jax.lax.optimization_barrier(jax.tree.map(jnp.asarray, tree))

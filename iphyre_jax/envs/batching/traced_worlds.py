"""Worlds inside the user's program: for accelerators, for gradients, and where a program must not call the host."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.batching.play_requests import PlayRequest, initial_episode
from iphyre_jax.envs.batching.status import Status, status_of
from iphyre_jax.envs.batching.topology_set import Games, TopologySet
from iphyre_jax.envs.params import EnvParams, EnvState, StepResult, Worlds
from iphyre_jax.observations.features import Features, Pose, own_features, pose_of, scene_tables
from iphyre_jax.observations.vectors import observe
from iphyre_jax.physics.shared_topologies import without_absent
from iphyre_jax.physics.types import Topology
from iphyre_jax.rollouts import EpisodeState
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

Tree = TypeVar("Tree")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedParams(EnvParams):
    """Games as arrays, padded to the largest."""

    table: Games  # as the solver reads them
    start: EpisodeState  # before the first step
    features: Features  # what an observation needs

    @property
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32."""
        return self.table.topology_id


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedState(EnvState):
    """An episode as the solver has it, padded to the largest."""

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
    def topology_set(self) -> TopologySet:
        """The topologies as one program."""
        return TopologySet.of(self.topologies, self.dtype)

    def params(self, scenes: Sequence[Scene]) -> TracedParams:
        """Return scenes as parameters."""
        topology_set = self.topology_set
        topology_ids, rows = [], []
        with jax.enable_x64(self.dtype == "float64"):
            for scene in scenes:
                topology_id, world = self.world_of(scene)
                topology_ids.append(topology_id)
                episode = initial_episode(self.topologies[topology_id], world)
                rows.append((topology_set.world.pad(world), topology_set.episode.pad(episode)))
            world, episode = _table(rows)
            features = _table([scene_tables(scene, self.topologies, self.dtype) for scene in scenes])
            return TracedParams(Games(world, jnp.asarray(topology_ids, jnp.int32)), episode, features)

    def single_game(self, params: TracedParams, game: int) -> tuple[Topology, TracedParams]:
        """Return the topology and the parameters of one game; see `params.Worlds`."""
        topology_id = int(params.table.topology_id[game])
        with jax.enable_x64(self.dtype == "float64"):
            padded, features = jax.tree.map(lambda leaf: np.asarray(leaf)[game], (params.table.world, params.features))
            shared = self.topologies[topology_id]
            topology, world = without_absent(shared, self.topology_set.worlds[topology_id].unpad(padded))
            own = world, initial_episode(topology, world), own_features(features, topology)
            world, first, features = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], own)
            return topology, TracedParams(Games(world, jnp.zeros(1, jnp.int32)), first, features)

    def reset(self, params: TracedParams, game: jax.Array) -> tuple[jax.Array, TracedState]:
        """Return the observation and the state of an episode before its first step."""
        row = jnp.asarray(game, jnp.int32)
        state = TracedState(_row(params.start, row), row, jnp.zeros(self.limits.blocks, bool))
        return self.observe(params, state), state

    def step(
        self,
        params: TracedParams,
        state: TracedState,
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: jax.Array,
    ) -> StepResult:
        """Play one decision; see `params.Worlds`."""
        times, games = _opaque((step_timing(self.protocol.fps, self.dtype), params.table))
        episode = self.topology_set.run(times, games, PlayRequest(state.row, plan, stop_step), state.episode)
        last = TracedState(episode, state.row, executed)
        status, final_obs = self.status(params, last), self.observe(params, last)
        ended = status.success | (status.fault != 0) | (status.step >= self.protocol.steps)
        follows = ended & (next_game >= 0)
        start = self.reset(params, jnp.maximum(next_game, 0))
        obs, now = jax.tree.map(lambda new, old: jnp.where(follows, new, old), start, (final_obs, last))
        return StepResult(now, obs, self.status(params, state), status, last, final_obs)

    def status(self, params: TracedParams, state: TracedState) -> Status:
        """Return the status of an episode."""
        return status_of(state.row, _row(params.table.world, state.row), state.episode, state.executed)

    def observe(self, params: TracedParams, state: TracedState) -> jax.Array:
        """Return the observation of an episode."""
        present, steps = self.status(params, state).present, jnp.asarray(self.protocol.steps)
        features = _row(params.features, state.row)
        return jnp.concatenate(observe(self.observation, features, present, state.episode, steps, no_op=self.no_op))

    def pose(self, params: TracedParams, state: TracedState) -> tuple[Features, Pose]:
        """Return what a picture of an episode needs."""
        features = _row(params.features, state.row)
        return features, pose_of(features, self.status(params, state).present, state.episode)


def _table(rows: Sequence[Tree]) -> Tree:
    """Stack trees of arrays, each a row, on the device."""
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *rows)


def _row(table: Tree, index: jax.Array) -> Tree:
    """Return one row of every array of a tree."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], table)


def _opaque(tree: Tree) -> Tree:
    """Hide arrays from the compiler, which would round constants differently."""
    return jax.lax.optimization_barrier(jax.tree.map(jnp.asarray, tree))

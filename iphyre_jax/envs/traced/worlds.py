"""Worlds inside the user's program: for accelerators, for gradients, and where a program must not call the host."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.envs.batching.next_game import NextGame
from iphyre_jax.envs.batching.play_requests import pack_request
from iphyre_jax.envs.batching.scene_features import feature_numbers
from iphyre_jax.envs.batching.status import GAME, Status, unpack_status
from iphyre_jax.envs.params import EnvParams, EnvState, StepResult, Tree, Worlds, stacked
from iphyre_jax.envs.traced.batch import decide
from iphyre_jax.envs.traced.scene_rows import scene_of, scene_tree
from iphyre_jax.envs.traced.step import Episode, Games, StepInput, TracedStep
from iphyre_jax.execution.layout import Parts
from iphyre_jax.observations.features import Features, own_features
from iphyre_jax.observations.vectors import obs_inputs, observe
from iphyre_jax.physics.shared_topologies import without_absent
from iphyre_jax.physics.types import Motion, State, Topology, World
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.compile import step_timing


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedParams(EnvParams):
    """Games as arrays, padded to the largest."""

    table: Games
    features: Features  # of each game, as in `table.scenes`; for what is not asked in lanes, as pictures
    made_for: str = field(metadata={"static": True})

    @property
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32."""
        return self.table.topology_id


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TracedState(EnvState):
    """A packed episode, padded to the largest."""

    parts: Parts  # see `Episode`
    state_of: str = field(metadata={"static": True})

    @property
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""
        return self.parts.whole[..., GAME].astype(jnp.int32)


@dataclass(frozen=True)
class TracedWorlds(Worlds):
    """Worlds of some topologies, see `params.Worlds`."""

    state_type = TracedState

    @cached_property
    def made_for(self) -> str:
        """See `params.Worlds`; parameters have first observations and states."""
        return self._digest(self.observation, self.no_op, self.traced.rows)

    @cached_property
    def state_of(self) -> str:
        """See `params.Worlds`."""
        return self._digest(self.protocol, self.traced.rows)

    @property
    def traced(self) -> TracedStep:
        """The decision of these worlds."""
        steps, shared = self.protocol.steps, (self.observation, self.limits, self.no_op, self.keep_final)
        return TracedStep(self.topologies, self.dtype, steps, *shared)

    def params_of(self, games: Sequence[tuple[int, World, Features]]) -> TracedParams:
        """Return games, each with its topology, as parameters."""
        with jax.enable_x64(self.dtype == "float64"):
            scenes, starts = [], []
            for topology_id, world, features in games:
                scene = self._scene(self.topologies[topology_id], world, features)
                starts.append(_start(self.traced, topology_id, scene))
                scenes.append(scene)
            ids = jax.device_put(np.array([topology_id for topology_id, _, _ in games], np.int32))
            table = Games(ids, stacked(scenes), stacked(starts))
            return TracedParams(table, stacked([own for _, _, own in games]), self.made_for)

    def _scene(self, topology: Topology, world: World, features: Features) -> Parts:
        """Return a packed scene, (rows,), with as many rows as the largest."""
        layout = self.traced.scene_layout(topology)
        words = layout.pack_many([scene_tree(feature_numbers(features, self.dtype), world)])[:, 0]
        parts = words[: layout.whole_rows], words[layout.whole_rows :].view(self.dtype)
        return Parts(*jax.device_put(parts)).padded(self.traced.scene_rows)

    def single_game(self, params: TracedParams, game: int) -> tuple[Topology, TracedParams]:
        """Return the topology and the parameters of one game; see `params.Worlds`."""
        topology_id = int(params.topology_id[game])
        scene, features = jax.tree.map(lambda leaf: np.asarray(leaf)[game], (params.table.scenes, params.features))
        layout = self.traced.scene_layout(self.topologies[topology_id])
        with jax.enable_x64(self.dtype == "float64"):
            _, joined = scene_of(layout.join(Parts(scene.whole[:, None], scene.numbers[:, None])))
            world = jax.tree.map(lambda leaf: np.asarray(leaf)[..., 0], joined)
        topology, world = without_absent(self.topologies[topology_id], world)
        one = replace(self, topologies=(topology,))
        return topology, one.params_of([(0, world, own_features(features, topology))])

    def reset(self, params: TracedParams, game: jax.Array) -> tuple[jax.Array, TracedState]:
        """Return the observation and the state of an episode before its first step."""
        row = jnp.asarray(game, jnp.int32)
        start: Episode = jax.tree.map(lambda leaf: leaf[row], params.table.start)
        return start.obs, TracedState(start.of_game(row).state, self.state_of)

    def step(
        self,
        params: TracedParams,
        state: TracedState,
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: NextGame,
    ) -> StepResult:
        """Play one decision; see `params.Worlds`."""
        timing = _opaque(step_timing(self.protocol.fps, self.dtype))
        request = pack_request(plan, stop_step, executed)
        given = StepInput(state.parts, request, next_game, jnp.zeros((), jnp.int32))
        out = decide(self.traced, timing, params.table, jax.tree.map(lambda leaf: leaf[None], given))
        out = jax.tree.map(lambda leaf: leaf[0], out)
        before, after = self.status(params, state), unpack_status(out.status, self.limits.blocks)
        now = TracedState(out.now.state, self.state_of)
        if not out.final:
            return StepResult(now, out.now.obs, before, after, None, None)
        final = out.final[0]
        return StepResult(now, out.now.obs, before, after, TracedState(final.state, self.state_of), final.obs)

    def first_rows(self, topology: Topology) -> State:
        """See `params.Worlds`; of the part that holds numbers."""
        return self.traced.episode_rows(topology).first_rows()

    def status(self, params: TracedParams, state: TracedState) -> Status:
        """Return the status of an episode."""
        del params
        return unpack_status(state.parts.whole[: self.traced.status_words], self.limits.blocks)

    def observe(self, params: TracedParams, state: TracedState) -> jax.Array:
        """Return the observation of an episode."""
        step, steps = self.status(params, state).step, jnp.asarray(self.protocol.steps)
        features, pose = self.pose(params, state)
        *_, x, y, angular_velocity = self.bodies(params, state)
        still = jnp.zeros_like(angular_velocity)
        motion = Motion(Vec(x, y), angular_velocity, Vec(still, still), still)
        return observe(features, obs_inputs(self.observation, features, pose, motion, step, steps), no_op=self.no_op)

    def bodies(self, params: TracedParams, state: TracedState) -> jax.Array:
        """Return the numbers of the moving bodies; see `params.Worlds`."""
        rows = jnp.asarray(self.body_rows(params.features.mover.shape[-1]))
        return state.parts.numbers[rows[params.topology_id[state.game]]]


@partial(jax.jit, static_argnums=(0, 1))
def _start(step: TracedStep, topology_id: int, scene: Parts) -> Episode:
    """Return the episode of a packed scene before its first step."""
    start = step.start(step.topologies[topology_id], jax.tree.map(lambda rows: rows[:, None], scene))
    return jax.tree.map(lambda rows: rows[:, 0], start)


def _opaque(tree: Tree) -> Tree:
    """Hide arrays from the compiler, which would round constants differently."""
    return jax.lax.optimization_barrier(jax.tree.map(jnp.asarray, tree))

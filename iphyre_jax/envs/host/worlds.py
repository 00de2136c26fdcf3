"""Worlds on a CPU: the host plays the episodes, in executables from compiler processes.

Inside a user's program a decision is one callback, in which the host plays the whole batch on all cores (`host.step`).
So the program compiles in a second whatever its games, and runs at the engine's speed. A callback is a pure function of
its arguments: JAX may drop it or call it twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Final

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from iphyre_jax.envs.batching.next_game import NO_GAME, NextGame
from iphyre_jax.envs.batching.play_requests import pack_request
from iphyre_jax.envs.batching.scene_features import feature_numbers, feature_shapes
from iphyre_jax.envs.batching.status import Status, status_words, unpack_status
from iphyre_jax.envs.host.calls import reset_episodes, step_episodes
from iphyre_jax.envs.host.observations import HostObservations
from iphyre_jax.envs.host.step import ID_WORDS, HostStep
from iphyre_jax.envs.host.step_program import EnvStep, scene_layout
from iphyre_jax.envs.params import EnvParams, EnvState, StepResult, Worlds, stacked
from iphyre_jax.execution import interrupts
from iphyre_jax.execution.devices import lanes_of
from iphyre_jax.execution.layout import WORD, Layout, Words
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.observations.features import Features, own_features
from iphyre_jax.observations.vectors import observation_size
from iphyre_jax.physics.shared_topologies import without_absent
from iphyre_jax.physics.types import State, Topology, World

HOSTS_CACHED: Final = 64  # sets of topologies; JAX's programs keep their own


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostParams(EnvParams):
    """Games as packed scenes."""

    scenes: jax.Array  # (games, words): an id of two words, features, then see `scene_layout`; padded
    ids: jax.Array  # (games,) int32, see `topology_id`
    features: Features  # of each game, padded to the largest; only pictures need them
    made_for: str = field(metadata={"static": True})

    @property
    def topology_id(self) -> jax.Array:
        """Topology of each game, (games,) int32."""
        return self.ids


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostState(EnvState):
    """A packed episode."""

    words: jax.Array  # (words,) see `EnvStep`; padded
    state_of: str = field(metadata={"static": True})

    @property
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""
        return self.words[..., 0].astype(jnp.int32)


@dataclass(frozen=True)
class HostWorlds(Worlds):
    """Worlds of some topologies, see `params.Worlds`."""

    state_type = HostState

    def params_of(self, games: Sequence[tuple[int, World, Features]]) -> HostParams:
        """Return games, each with its topology, as parameters."""
        rows = [self._row(self.topologies[topology_id], world, own) for topology_id, world, own in games]
        # As wide as the largest topology needs: tables of any scenes have one shape, and share compiled programs.
        most = max(scene_layout(topology, self.dtype).rows for topology in self.topologies)
        table = np.zeros((len(rows), ID_WORDS + self.features.rows + most), WORD[self.dtype])
        for k, row in enumerate(rows):
            table[k, : len(row)] = row
        with jax.enable_x64(self.dtype == "float64"):
            ids = jax.device_put(np.array([topology_id for topology_id, _, _ in games], np.int32))
            features = stacked([own for _, _, own in games])
            return HostParams(jax.device_put(table), ids, features, self.made_for)

    def _row(self, topology: Topology, world: Any, features: Features) -> Words:  # noqa: ANN401 - NumPy arrays
        """Return a packed scene, its id in front."""
        bars = np.asarray(features.ends)[: topology.bars]
        words = scene_layout(topology, self.dtype).pack_many([(world, bars)])[:, 0]
        obs = self.features.pack_many([feature_numbers(features, self.dtype)])[:, 0]
        digest = hashlib.sha256(repr((topology, self.limits)).encode() + obs.tobytes() + words.tobytes()).digest()
        own = np.frombuffer(digest[: 4 * ID_WORDS], np.int32).astype(words.dtype)
        return np.concatenate([own, obs, words])

    @property
    def features(self) -> Layout:
        """Layout of the features in a packed scene, padded to the largest topology."""
        return _feature_layout(self)

    def single_game(self, params: HostParams, game: int) -> tuple[Topology, HostParams]:
        """Return the topology and the parameters of one game; see `params.Worlds`."""
        shared = self.topologies[int(params.topology_id[game])]
        first = ID_WORDS + self.features.rows
        layout = scene_layout(shared, self.dtype)
        words = np.asarray(params.scenes)[game, first : first + layout.rows]
        padded = jax.tree.map(lambda leaf: leaf[..., 0], layout.unpack_numpy(words[:, None]))[0]
        topology, world = without_absent(shared, padded)
        one = replace(self, topologies=(topology,))
        features = own_features(jax.tree.map(lambda leaf: np.asarray(leaf)[game], params.features), topology)
        return topology, one.params_of([(0, world, features)])

    def reset(self, params: HostParams, game: jax.Array) -> tuple[jax.Array, HostState]:
        """Return the observation and the state of an episode before its first step."""
        words, obs = self._call(reset_episodes, ["words", "obs"], params, game)
        return obs, HostState(words, self.state_of)

    def step(
        self,
        params: HostParams,
        state: HostState,
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: NextGame,
    ) -> StepResult:
        """Play one decision; see `params.Worlds`."""
        requests = pack_request(plan, stop_step, executed).astype(WORD[self.dtype])
        results = ["words", "obs", "status", "status", *(["words", "obs"] if self.keep_final else [])]
        # The call writes the episodes where they are, or a scan would copy them at each decision. So they must have all
        # axes of a batch, even if the states are all the same; and nothing may read them afterwards: the call returns
        # the status before the decision too.
        game = next_game.row()
        axes = 0 * (requests[0] + game + params.topology_id[0])
        words = state.words + axes.astype(state.words.dtype)
        own = words, requests, game
        words, obs, before, status, *last = self._call(step_episodes, results, params, *own, in_place=True)
        final_state, final_obs = (HostState(last[0], self.state_of), last[1]) if last else (None, None)
        was, now = (unpack_status(words, self.limits.blocks) for words in (before, status))
        return StepResult(HostState(words, self.state_of), obs, was, now, final_state, final_obs)

    def first_rows(self, topology: Topology) -> State:
        """See `params.Worlds`."""
        own: State = episode_layout(topology, self.dtype).first_rows().state
        return jax.tree.map(lambda row: row + status_words(self.limits.blocks), own)

    def status(self, params: HostParams, state: HostState) -> Status:
        """Return the status of an episode."""
        del params
        return unpack_status(state.words[: status_words(self.limits.blocks)], self.limits.blocks)

    def observe(self, params: HostParams, state: HostState) -> jax.Array:
        """Return the observation of an episode."""
        status = self.status(params, state)
        never, none = jnp.full(self.limits.blocks, -1, jnp.int32), NextGame(jnp.full_like(status.game, NO_GAME))
        return self.step(params, state, never, status.step, status.executed, none).obs

    def bodies(self, params: HostParams, state: HostState) -> jax.Array:
        """Return the numbers of the moving bodies; see `params.Worlds`."""
        rows = jnp.asarray(self.body_rows(params.features.mover.shape[-1]))
        return jax.lax.bitcast_convert_type(state.words[rows[params.topology_id[state.game]]], self.dtype)

    def _call(
        self,
        callback: Callable[..., None],
        results: Sequence[str],
        params: HostParams,
        *own: jax.Array,
        in_place: bool = False,
    ) -> list[jax.Array]:
        """Call the host from a program; under `jax.vmap` once for the whole batch.

        in_place: whether the first result takes the place of the first argument after the parameters.
        """
        host = _host(self)
        host.prepare()  # while the program is traced, so that an interrupt ends it here
        interrupts.watch()
        word = WORD[self.dtype]
        shapes = {
            "words": jax.ShapeDtypeStruct((host.episode_words,), word),
            "obs": jax.ShapeDtypeStruct((self._obs_size(),), np.float32),
            "status": jax.ShapeDtypeStruct((host.status_words,), word),
        }
        call = buffer_callback(
            partial(callback, host),
            [shapes[name] for name in results],
            vmap_method="expand_dims",
            input_output_aliases={2: 0} if in_place else None,
        )
        out: list[jax.Array] = call(params.scenes, params.topology_id, *own)
        return out

    def _obs_size(self) -> int:
        """Return the length of an observation."""
        return observation_size(self.observation, self.limits.objects, self.limits.blocks + self.no_op)


@lru_cache(HOSTS_CACHED)
def _host(worlds: HostWorlds) -> HostStep:
    """Return the host that plays the worlds."""
    dtype, slots = worlds.dtype, worlds.limits.blocks
    programs = [EnvStep(t, dtype, lanes_of(t, dtype), slots) for t in worlds.topologies]
    make_observations = partial(HostObservations, observation=worlds.observation, no_op=worlds.no_op)
    return HostStep(programs, worlds.protocol, worlds.features, make_observations)


@lru_cache(1024)
def _feature_layout(worlds: HostWorlds) -> Layout:
    """Return the layout of `feature_numbers` of scenes."""
    return Layout.of(feature_shapes(worlds.topologies, worlds.limits, worlds.dtype), worlds.dtype)

"""Worlds on a CPU: episodes are played by the host, in executables that were compiled apart.

Inside a user's program a decision is one call of the host, which plays the whole batch on all cores (`host_step`). So
the program compiles in a second whatever its games, and runs at the engine's speed. A call is a pure function of its
arguments: it may be left out or made twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from iphyre_jax.envs.batching.host_calls import reset_episodes, step_episodes
from iphyre_jax.envs.batching.host_observations import HostObservations
from iphyre_jax.envs.batching.host_step import ID_WORDS, HostStep
from iphyre_jax.envs.batching.status import Status, status_words, unpack_status
from iphyre_jax.envs.batching.step_program import EnvStep, scene_layout
from iphyre_jax.envs.params import EnvParams, EnvState, StepResult, Worlds
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import lanes_of
from iphyre_jax.execution.layout import WORD, Layout, Words
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.observations.features import Features, Pose, objects_there, own_features, scene_tables
from iphyre_jax.observations.official import COLUMNS
from iphyre_jax.observations.vectors import observation_size
from iphyre_jax.physics.types import Topology
from iphyre_jax.rollouts import FAULT_NOT_FINITE
from iphyre_jax.scenes import Limits, Scene


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostParams(EnvParams):
    """Games as words."""

    scenes: jax.Array  # (games, words): an id of two words, then as of `scene_layout`, filled up
    ids: jax.Array  # (games,) int32, index into the topologies
    features: Features  # of each game, filled up to the largest; what pictures need

    @property
    def games(self) -> int:
        """The number of games."""
        return self.ids.shape[-1]

    @property
    def topology_id(self) -> jax.Array:
        """Topology of each game."""
        return self.ids


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostState(EnvState):
    """An episode as words."""

    words: jax.Array  # (words,) as of `EnvStep`, filled up

    @property
    def game(self) -> jax.Array:
        """Row of the parameters, () int32."""
        return self.words[..., 0].astype(jnp.int32)


@dataclass(frozen=True)
class HostWorlds(Worlds):
    """Worlds of some topologies, see `params.Worlds`."""

    keep_final: bool  # whether `step` also returns an episode that has ended as it was then

    def params(self, scenes: Sequence[Scene]) -> HostParams:
        """Return scenes as parameters."""
        built = [cached_world(scene, self.protocol.resets, self.dtype) for scene in scenes]
        topology_id = [self.topologies.index(topology) for topology, _ in built]
        features = [scene_tables(scene, self.topologies, self.dtype) for scene in scenes]
        rows = [self._row(*pair, own) for pair, own in zip(built, features, strict=True)]
        table = np.zeros((len(rows), max(map(len, rows))), WORD[self.dtype])
        for k, row in enumerate(rows):
            table[k, : len(row)] = row
        with jax.enable_x64(self.dtype == "float64"):
            stacked = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *features)
            return HostParams(jnp.asarray(table), jnp.asarray(topology_id, jnp.int32), stacked)

    def _row(self, topology: Topology, world: Any, features: Features) -> Words:  # noqa: ANN401 - NumPy arrays
        """Return the words of a scene, its id in front."""
        bars = np.asarray(features.ends)[: topology.bars]
        words = scene_layout(topology, self.dtype).pack_many([(world, bars)])[:, 0]
        obs = self.features.pack_many([_numbers(features, self.dtype)])[:, 0]
        digest = hashlib.sha256(repr((topology, self.limits)).encode() + obs.tobytes() + words.tobytes()).digest()
        own = np.frombuffer(digest[: 4 * ID_WORDS], np.int32).astype(words.dtype)
        return np.concatenate([own, obs, words])

    @property
    def features(self) -> Layout:
        """Layout of the features of a scene, filled up to the largest topology, in its words."""
        return _feature_layout(self.topologies, self.limits, self.dtype)

    def single_game(self, params: HostParams, game: int) -> HostParams:
        """Return the parameters of one game, for worlds of its topology alone (host)."""
        topology = self.topologies[int(params.topology_id[game])]
        first = ID_WORDS + self.features.rows
        layout = scene_layout(topology, self.dtype)
        words = np.asarray(params.scenes)[game, first : first + layout.rows]
        world = jax.tree.map(lambda leaf: leaf[..., 0], layout.unpack_numpy(words[:, None]))[0]
        one = replace(self, topologies=(topology,))
        with jax.enable_x64(self.dtype == "float64"):
            features = own_features(jax.tree.map(lambda leaf: np.asarray(leaf)[game], params.features), topology)
            row = one._row(topology, world, features)
            stacked = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], features)
            return HostParams(jnp.asarray(row)[None], jnp.zeros(1, jnp.int32), stacked)

    def reset(self, params: HostParams, game: jax.Array) -> tuple[jax.Array, HostState]:
        """Return what is seen, and the state, of an episode before its first step."""
        words, obs = self._call(reset_episodes, ["words", "obs"], params, game)
        return obs, HostState(words)

    def step(
        self,
        params: HostParams,
        state: HostState,
        plan: jax.Array,
        stop_step: jax.Array,
        executed: jax.Array,
        next_game: jax.Array,
    ) -> StepResult:
        """Play on; see `params.Worlds`."""
        requests = jnp.concatenate([plan, stop_step[None], executed]).astype(WORD[self.dtype])
        results = ["words", "obs", "status", *(["words", "obs"] if self.keep_final else [])]
        words, obs, status, *last = self._call(step_episodes, results, params, state.words, requests, next_game)
        final_state, final_obs = (HostState(last[0]), last[1]) if last else (None, None)
        return StepResult(HostState(words), obs, unpack_status(status), final_state, final_obs)

    def status(self, params: HostParams, state: HostState) -> Status:
        """Return the status of an episode."""
        del params
        return unpack_status(state.words[: status_words(self.limits.blocks)])

    def observe(self, params: HostParams, state: HostState) -> jax.Array:
        """Return what is seen of an episode."""
        status = self.status(params, state)
        never, none = jnp.full(self.limits.blocks, -1, jnp.int32), jnp.full_like(status.game, -1)
        return self.step(params, state, never, status.step, status.executed, none).obs

    def pose(self, params: HostParams, state: HostState) -> tuple[Features, Pose]:
        """Return what a picture of an episode needs."""
        features = jax.tree.map(lambda leaf: leaf[state.game], params.features)
        status, bodies = self.status(params, state), features.mover.shape[0]
        places = [self._places(topology, bodies) for topology in self.topologies]
        # A body that a smaller topology does not have is read from row 0, and shown nowhere.
        numbers = jax.lax.bitcast_convert_type(
            state.words[jnp.asarray(places)[params.topology_id[state.game]]], self.dtype
        )
        x, y, angle = numbers.reshape(3, bodies)
        sound = status.fault != FAULT_NOT_FINITE
        return features, Pose(x, y, angle, objects_there(features, status.present), sound)

    def _places(self, topology: Topology, bodies: int) -> list[int]:
        """Return where the words of an episode have x, y and angle of each moving body."""
        places, first = episode_layout(topology, self.dtype).places(), status_words(self.limits.blocks)
        own = (places.state.position.x, places.state.position.y, places.state.angle)
        moving = range(topology.moving)
        return [
            place for start in own for place in [*(first + start + k for k in moving), *[0] * (bodies - len(moving))]
        ]

    def _call(
        self, callback: Callable[..., None], results: Sequence[str], params: HostParams, *own: jax.Array
    ) -> list[jax.Array]:
        """Call the host inside a program; under `jax.vmap` once for the whole batch."""
        host = _host(self)
        host.prepare()  # now, while the program is traced: an interrupt ends it here
        word = WORD[self.dtype]
        shapes = {
            "words": jax.ShapeDtypeStruct((host.episode_words,), word),
            "obs": jax.ShapeDtypeStruct((self._obs_size(),), np.float32),
            "status": jax.ShapeDtypeStruct((host.status,), word),
        }
        call = buffer_callback(partial(callback, host), [shapes[name] for name in results], vmap_method="expand_dims")
        out: list[jax.Array] = call(params.scenes, params.topology_id, *own)
        return out

    def _obs_size(self) -> int:
        """Return how many numbers an observation has."""
        return observation_size(self.observation, self.limits.objects, self.limits.blocks + self.no_op)


@cache
def _host(worlds: HostWorlds) -> HostStep:
    """Return what plays the worlds."""
    dtype, slots = worlds.dtype, worlds.limits.blocks
    programs = [EnvStep(t, dtype, lanes_of(t, dtype), slots) for t in worlds.topologies]
    make_observations = partial(HostObservations, observation=worlds.observation, no_op=worlds.no_op)
    return HostStep(programs, worlds.protocol, worlds.features, make_observations)


@cache
def _feature_layout(topologies: tuple[Topology, ...], limits: Limits, dtype: str) -> Layout:
    """Return the layout of `_numbers` of scenes of some topologies."""

    def most(count: Callable[[Topology], int]) -> int:
        return max(map(count, topologies))

    def array(*shape: int, of: str = dtype) -> Any:  # noqa: ANN401 - it stands for an array
        return jax.ShapeDtypeStruct(shape, of)

    objects, blocks, bars = limits.objects, limits.blocks, most(lambda topology: topology.bars)
    features = Features(
        object_rows=None,
        obs_rows=array(objects, COLUMNS),
        mover=array(most(lambda topology: topology.moving), of="int32"),
        ends=array(bars, 2, 2),
        slot_object=array(blocks, of="int32"),
        joints=array(most(lambda topology: len(topology.pins)), objects, of="bool"),
        springs=array(most(lambda topology: len(topology.springs)), objects, of="bool"),
        candidates=array(blocks, 2),
    )
    return Layout.of(features, dtype)


def _numbers(features: Features, dtype: str) -> Features:
    """Return features (NumPy) with all numbers of one dtype, without those that only pictures need."""
    numbers: dict[str, Any] = {name: np.asarray(getattr(features, name), dtype) for name in ("obs_rows", "candidates")}
    return replace(features, object_rows=None, **numbers)

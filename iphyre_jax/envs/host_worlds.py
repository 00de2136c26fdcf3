"""Worlds on a CPU: episodes are played by the host, in executables that were compiled apart.

Inside a user's program a decision is one call of the host, which plays the whole batch on all cores (`host_step`). So
the program compiles in a second whatever its games, and runs at the engine's speed. A call is a pure function of its
arguments: it may be left out or made twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from math import prod
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax.experimental.buffer_callback import buffer_callback

from iphyre_jax.envs.features import Features, Pose, objects_there, own_features, scene_tables, without_rows
from iphyre_jax.envs.host_step import ID_WORDS, HostStep
from iphyre_jax.envs.observations import ObservationName
from iphyre_jax.envs.params import EnvParams, EnvState, Played
from iphyre_jax.envs.protocols import Protocol
from iphyre_jax.envs.status import Status, status_words, unpack_status
from iphyre_jax.envs.step_program import EnvStep, scene_layout
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.devices import lanes_of
from iphyre_jax.execution.layout import WORD, Words
from iphyre_jax.execution.programs import progress_layout
from iphyre_jax.physics.types import Topology
from iphyre_jax.rollouts import FAULT_NOT_FINITE
from iphyre_jax.scenes import Limits, Scene


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class HostParams(EnvParams):
    """Games as words."""

    scenes: jax.Array  # (games, words): an id of two words, then as of `scene_layout`, filled up
    kinds: jax.Array  # (games,) int32, index into the topologies
    features: Features  # of each game, filled up to the largest; what pictures need

    @property
    def games(self) -> int:
        """The number of games."""
        return self.kinds.shape[-1]

    @property
    def kind(self) -> jax.Array:
        """Topology of each game."""
        return self.kinds


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
class HostWorlds:
    """Worlds of some topologies, see `params.Worlds`; hashable. Attributes as of `Environment`."""

    topologies: tuple[Topology, ...]
    dtype: str
    protocol: Protocol
    observation: ObservationName
    limits: Limits
    no_op: bool
    keep_last: bool  # whether `play` also returns an episode that has ended as it was then

    def params(self, scenes: Sequence[Scene]) -> HostParams:
        """Return scenes as parameters."""
        built = [cached_world(scene, self.protocol.resets, self.dtype) for scene in scenes]
        kind = [self.topologies.index(topology) for topology, _ in built]
        rows = [self._row(scene, *pair) for scene, pair in zip(scenes, built, strict=True)]
        table = np.zeros((len(rows), max(map(len, rows))), WORD[self.dtype])
        for k, row in enumerate(rows):
            table[k, : len(row)] = row
        features = [scene_tables(scene, self.topologies, self.dtype) for scene in scenes]
        with jax.enable_x64(self.dtype == "float64"):
            stacked = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *features)
            return HostParams(jnp.asarray(table), jnp.asarray(kind, jnp.int32), stacked)

    def _row(self, scene: Scene, topology: Topology, world: Any) -> Words:  # noqa: ANN401 - a `World` of NumPy arrays
        """Return the words of a scene, its id in front."""
        layout = scene_layout(topology, self.limits, self.dtype)
        features = without_rows(scene_tables(scene, [topology], self.dtype), self.dtype)
        words = layout.pack_many([(world, features)])[:, 0]
        digest = hashlib.sha256(repr((topology, self.limits)).encode() + words.tobytes()).digest()
        own = np.frombuffer(digest[: 4 * ID_WORDS], np.int32).astype(words.dtype)
        return np.concatenate([own, words])

    def alone(self, params: HostParams, game: int) -> HostParams:
        """Return the parameters of one game, for worlds of its topology alone (host)."""
        topology = self.topologies[int(params.kind[game])]
        width = ID_WORDS + scene_layout(topology, self.limits, self.dtype).rows
        with jax.enable_x64(self.dtype == "float64"):
            scenes = jnp.asarray(np.asarray(params.scenes)[game : game + 1, :width])
            features = own_features(jax.tree.map(lambda leaf: leaf[game], params.features), topology)
            return HostParams(scenes, jnp.zeros(1, jnp.int32), jax.tree.map(lambda leaf: leaf[None], features))

    def begin(self, params: HostParams, game: jax.Array) -> tuple[jax.Array, HostState]:
        """Return what is seen, and the state, of an episode before its first step."""
        words, seen = self._call(_begin, ["words", "seen"], params, game)
        return seen, HostState(words)

    def play(
        self,
        params: HostParams,
        state: HostState,
        plan: jax.Array,
        until: jax.Array,
        executed: jax.Array,
        next_game: jax.Array,
    ) -> Played:
        """Play on; see `params.Worlds`."""
        orders = jnp.concatenate([plan, until[None], executed]).astype(WORD[self.dtype])
        results = ["words", "seen", "status", *(["words", "seen"] if self.keep_last else [])]
        words, seen, status, *last = self._call(_play, results, params, state.words, orders, next_game)
        last_state, last_seen = (HostState(last[0]), last[1]) if last else (None, None)
        return Played(HostState(words), seen, unpack_status(status), last_state, last_seen)

    def status(self, params: HostParams, state: HostState) -> Status:
        """Return the status of an episode."""
        del params
        return unpack_status(state.words[: status_words(self.limits.blocks)])

    def observe(self, params: HostParams, state: HostState) -> jax.Array:
        """Return what is seen of an episode."""
        status = self.status(params, state)
        never, none = jnp.full(self.limits.blocks, -1, jnp.int32), jnp.full_like(status.game, -1)
        return self.play(params, state, never, status.step, status.executed, none).seen

    def pose(self, params: HostParams, state: HostState) -> tuple[Features, Pose]:
        """Return what a picture of an episode needs."""
        features = jax.tree.map(lambda leaf: leaf[state.game], params.features)
        status, bodies = self.status(params, state), features.mover.shape[0]
        places = [self._places(topology, bodies) for topology in self.topologies]
        # A body that a smaller topology does not have is read from row 0, and shown nowhere.
        numbers = jax.lax.bitcast_convert_type(state.words[jnp.asarray(places)[params.kind[state.game]]], self.dtype)
        x, y, angle = numbers.reshape(3, bodies)
        sound = status.fault != FAULT_NOT_FINITE
        return features, Pose(x, y, angle, objects_there(features, status.standing), sound)

    def _places(self, topology: Topology, bodies: int) -> list[int]:
        """Return where the words of an episode have x, y and angle of each moving body."""
        places, first = progress_layout(topology, self.dtype).places(), status_words(self.limits.blocks)
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
        word, program = WORD[self.dtype], host.programs[0]
        shapes = {
            "words": jax.ShapeDtypeStruct((host.row,), word),
            "seen": jax.ShapeDtypeStruct((program.seen,), np.float32),
            "status": jax.ShapeDtypeStruct((host.status,), word),
        }
        call = buffer_callback(partial(callback, host), [shapes[name] for name in results], vmap_method="expand_dims")
        out: list[jax.Array] = call(params.scenes, params.kind, *own)
        return out


@cache
def _host(worlds: HostWorlds) -> HostStep:
    """Return what plays the worlds."""
    seen: ObservationName = "official" if worlds.observation == "image" else worlds.observation
    programs = [
        EnvStep(t, worlds.dtype, lanes_of(t, worlds.dtype), seen, worlds.limits, worlds.no_op)
        for t in worlds.topologies
    ]
    return HostStep(programs, worlds.protocol)


def _begin(host: HostStep, _: object, out: Sequence[object], *given: object) -> None:
    """Fill in the beginnings of episodes; arguments are buffers, each with the batch's axes or ones in front."""
    words, seen = _flat(out)
    batch = np.asarray(out[0]).shape[:-1]
    scenes, kind, first = _tables(given, batch)
    game: Words = np.broadcast_to(np.asarray(given[2]), batch).reshape(-1)
    words[:], seen[:] = host.begin(scenes, kind, game + first)
    words[:, 0] = game


def _play(host: HostStep, _: object, out: Sequence[object], *given: object) -> None:
    """Fill in what comes of one decision of each episode; arguments as of `_begin`."""
    words, seen, status, *last = _flat(out)
    batch = np.asarray(out[0]).shape[:-1]
    scenes, kind, first = _tables(given, batch)
    episodes, orders = (_rows(part, batch) for part in given[2:4])
    next_game = np.broadcast_to(np.asarray(given[4]), batch).reshape(-1)
    if np.ndim(first):  # each world has games of its own
        episodes = episodes.copy()
        episodes[:, 0] += first
        next_game = np.where(next_game < 0, next_game, next_game + first)
    host.play(scenes, kind, episodes, orders, next_game, (words, seen, status), (last[0], last[1]) if last else None)
    if np.ndim(first):
        for rows in (words, status, *last[:1]):
            rows[:, 0] -= first


def _flat(buffers: Sequence[object]) -> list[npt.NDArray[Any]]:
    """Return buffers as arrays with one axis for the batch."""
    return [array.reshape(-1, array.shape[-1]) for array in map(np.asarray, buffers)]


def _rows(buffer: object, batch: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return a buffer of rows as an array with one axis for the batch."""
    array = np.asarray(buffer)
    return np.broadcast_to(array, (*batch, array.shape[-1])).reshape(-1, array.shape[-1])


def _tables(given: Sequence[object], batch: tuple[int, ...]) -> tuple[Words, Words, int | npt.NDArray[np.intp]]:
    """Return scenes and kinds as one table, and the row at which the games of each world begin."""
    scenes, kind = np.asarray(given[0]), np.asarray(given[1])
    games, axes = kind.shape[-1], kind.shape[:-1]
    tables = scenes.reshape(-1, scenes.shape[-1]), kind.reshape(-1)
    if prod(axes) <= 1:
        return *tables, 0
    first = games * np.arange(prod(axes)).reshape(axes)
    return *tables, np.broadcast_to(first, batch).reshape(-1)

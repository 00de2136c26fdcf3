"""An episode as it is kept between the decisions of a batch: in few words, because each decision turns them over.

Flags are bits. A decision leaves a world as its last step did, so what its result shares with the state of its bodies
is kept once. And contact slots that hardly any world needs (`Topology.few_slots`) stand behind all other rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp

from iphyre_jax import rollouts
from iphyre_jax.envs.batching.status import Status, status_rows, status_words, unpack_status
from iphyre_jax.execution.layout import Layout, Parts, flag_words, pack_flags, unpack_flags
from iphyre_jax.physics.types import Cache, State, Topology, World
from iphyre_jax.rollouts import EpisodeResult, EpisodeState

CROWDED, OVERFLOW, FLAGS = 0, 1, 2  # flags of a state; the others follow


@dataclass(frozen=True)
class EpisodeRows:
    """The rows of an episode: its status, see `status_rows`, the flags of its state, and what else is in that.

    Attributes:
        topology: of the world.
        blocks: plan slots.
        dtype: of the physics.
    """

    topology: Topology
    blocks: int
    dtype: str

    @property
    def usual(self) -> tuple[int, int]:
        """Rows of the two parts, without those of further contact slots."""
        whole, numbers = self._state.part_rows
        return self._first + whole, numbers

    @property
    def all(self) -> tuple[int, int]:
        """Rows of the two parts."""
        (whole, numbers), rows = self.usual, 3 * (self.topology.slots - self.topology.few_slots)
        return whole + rows, numbers + 2 * rows

    def pack(self, status: Status, episode: EpisodeState) -> Parts:
        """Return an episode, as a decision leaves it, as its rows; lanes behind."""
        state, few = episode.state, self.topology.few_slots
        further = jax.tree.map(lambda rows: rows[:, few:].reshape(-1, rows.shape[-1]), state.cache)
        crowded = jnp.any(further.point >= 0, axis=0)
        flags = pack_flags([crowded, state.overflow, *state.broad.updated, *state.alive])
        whole, numbers = self._state.parts(_without_flags(self.topology, state))
        rows = [row.astype(whole.dtype)[None] for row in (*status_rows(status), *flags)]
        return Parts(
            jnp.concatenate([*rows, whole, further.point.astype(whole.dtype)]),
            jnp.concatenate([numbers, further.normal_impulse, further.tangent_impulse]),
        )

    def join(self, parts: Parts) -> tuple[Status, EpisodeState]:
        """Return the status and the episode of rows, lanes behind; rows behind those of the topology do not matter."""
        status = unpack_status(parts.whole[: status_words(self.blocks)], self.blocks)
        flags, moving = self._flags(parts.whole), self.topology.moving
        state = self._state.join(Parts(parts.whole[self._first :], parts.numbers))
        state = replace(
            state,
            alive=flags[FLAGS + moving :],
            broad=replace(state.broad, updated=flags[FLAGS : FLAGS + moving]),
            cache=self._cache(state.cache, parts),
            step=status.step,
            overflow=flags[OVERFLOW],
        )
        done = status.success | (status.fault != 0)
        own = status.success, status.step, status.eliminations, status.fault
        return status, EpisodeState(state, EpisodeResult(state.position, state.angle, done, *own))

    def is_crowded(self, whole: jax.Array) -> jax.Array:
        """Return where further contact slots are in use, (lanes,) bool; whole: the usual rows of that part."""
        return self._flags(whole)[CROWDED]

    def first_rows(self) -> State:
        """Return the first row of each array of numbers of a state, in their part."""
        rows: State = jax.tree.map(lambda row: row - self._state.whole_rows, self._state.first_rows())
        return rows

    def _cache(self, few: Cache, parts: Parts) -> Cache:
        """Return the cache of all slots; few: of the first ones."""
        (whole, numbers), (_, most) = self.usual, self.all
        each = (most - numbers) // 2
        further = Cache(
            parts.whole[whole : whole + each].astype(jnp.int32),
            parts.numbers[numbers : numbers + each],
            parts.numbers[numbers + each : most],
        )

        def both(first: jax.Array, rows: jax.Array) -> jax.Array:
            return jnp.concatenate([first, rows.reshape(len(first), -1, rows.shape[-1])], axis=1)

        return jax.tree.map(both, few, further)

    def _flags(self, whole: jax.Array) -> jax.Array:
        return unpack_flags(whole[status_words(self.blocks) : self._first], self._flag_count)

    @property
    def _flag_count(self) -> int:
        return FLAGS + self.topology.moving + self.topology.num_static

    @property
    def _first(self) -> int:
        """The first row of what is in neither status nor flags."""
        return status_words(self.blocks) + flag_words(self._flag_count)

    @property
    def _state(self) -> Layout:
        return _state_layout(self.topology, self.dtype)


def _without_flags(topology: Topology, state: State) -> Any:  # noqa: ANN401 - a state with holes
    """Return a state without flags, step and further contact slots."""
    few: Any = state.cache.with_slots(topology.few_slots)
    hole: Any = ()
    return replace(state, alive=hole, broad=replace(state.broad, updated=hole), cache=few, step=hole, overflow=hole)


@lru_cache(1024)
def _state_layout(topology: Topology, dtype: str) -> Layout:
    def bare(world: World, done: jax.Array) -> Any:  # noqa: ANN401
        return _without_flags(topology, rollouts.reset_episode(topology, world, done).state)

    with jax.enable_x64(dtype == "float64"):
        world, done = World.shapes(topology, dtype), jax.ShapeDtypeStruct((), "bool")
        return Layout.of(jax.eval_shape(bare, world, done), dtype)

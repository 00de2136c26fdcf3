"""The program of the environments on a CPU: one decision of worlds of one topology, some side by side.

A call costs some 30 us before it plays a world, and finds the caches full of other programs. So it plays several
groups of lanes, one after the other.

A packed episode is a row: the words of its status, then those of its physics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Final

import jax
import jax.numpy as jnp

from iphyre_jax import rollouts
from iphyre_jax.envs.batching.play_requests import request_words, run_requests, unpack_request
from iphyre_jax.envs.batching.status import status_of, status_rows, status_words
from iphyre_jax.execution import programs
from iphyre_jax.execution.layout import Layout, write_transposed
from iphyre_jax.execution.one_function import in_branch, in_one_function
from iphyre_jax.observations.features import Pose, scaled_ends, speeds
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import FAULT_NOT_FINITE, EpisodeState

GROUPS: Final = 8  # most groups of lanes in a call
BODY_OBS: Final = 7  # numbers of the observation of a moving body
RESET: Final = -1  # in place of `stop_step`: the episode is reset, and no step is made


@lru_cache(1024)
def scene_layout(topology: Topology, dtype: str) -> Layout:
    """Return the layout of a scene: its world, and `Features.ends`."""
    tree = World.shapes(topology, dtype), jax.ShapeDtypeStruct((topology.bars, 2, 2), dtype)
    return Layout.of(tree, dtype)


@dataclass(frozen=True)
class EnvStep:
    """One decision of groups of worlds of one topology, for any strategy: it takes plans and the steps to play to.

    Attributes:
        topology: of the worlds.
        dtype: of the physics.
        lanes: worlds side by side, a group.
        slots: plan slots.
    """

    sources: ClassVar[tuple[str, ...]] = (
        *programs.SOURCES,
        "observations/official.py",
        "observations/features.py",
        "envs/host/step_program.py",
        "envs/batching/status.py",
        "envs/batching/play_requests.py",
    )

    topology: Topology
    dtype: str
    lanes: int
    slots: int

    @property
    def episode_words(self) -> int:
        """Words of an episode."""
        return status_words(self.slots) + programs.episode_layout(self.topology, self.dtype).rows

    @property
    def body_obs_size(self) -> int:
        """Numbers of the observation of the moving bodies: `scaled_ends` and `speeds` of each."""
        return BODY_OBS * self.topology.moving

    @property
    def request_words(self) -> int:
        """Words of a packed request; `stop_step` may be RESET."""
        return request_words(self.slots)

    @property
    def most_worlds(self) -> int:
        """The most worlds that a call plays."""
        return GROUPS * self.lanes

    def arguments(self) -> programs.Shapes:
        """Return the shapes of scenes, worlds, packed timing, and the number of groups that are played, (1,).

        Scenes, (GROUPS, words, lanes), have the words of `scene_layout`. Worlds, (GROUPS * lanes, words), have a row
        for an episode and its request. Groups that are not played are not read.
        """
        scene = scene_layout(self.topology, self.dtype)
        return (
            jax.ShapeDtypeStruct((GROUPS, scene.rows, self.lanes), scene.word),
            jax.ShapeDtypeStruct((self.most_worlds, self.episode_words + self.request_words), scene.word),
            jax.ShapeDtypeStruct((programs.TIMING_NUMBERS,), self.dtype),
            jax.ShapeDtypeStruct((1,), "int32"),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the episodes and the bits of the observations of their bodies, (GROUPS * lanes, words)."""
        return (in_one_function(self._play, *arguments),)

    def _play(self, scenes: jax.Array, worlds: jax.Array, numbers: jax.Array, groups: jax.Array) -> jax.Array:
        timing = programs.unpack_timing(numbers)

        def play(group: jax.Array, out: jax.Array) -> jax.Array:
            first = group * self.lanes
            scene = jax.lax.dynamic_index_in_dim(scenes, group, keepdims=False)
            own = jax.lax.dynamic_slice_in_dim(worlds, first, self.lanes)
            # Behind a barrier: otherwise each number is looked up where it is used.
            scene, own = jax.lax.optimization_barrier((scene, own))
            world, ends = scene_layout(self.topology, self.dtype).unpack(scene)
            column = 0
            for table in self._step(world, ends, own.T, timing, groups[0] > 0):
                out = write_transposed(table, out, first, column)
                column += table.shape[0]
            return out

        out = jnp.zeros((self.most_worlds, self.episode_words + self.body_obs_size), worlds.dtype)
        return jax.lax.fori_loop(0, groups[0], play, out)

    def _step(
        self, world: World, ends: jax.Array, worlds: jax.Array, timing: Timing, always: jax.Array
    ) -> tuple[jax.Array, ...]:
        """Return words and numbers of the episodes, and observations of their bodies; all have lanes behind.

        always: () bool, True, which the compiler must not know.
        """
        first = status_words(self.slots)
        layout = programs.episode_layout(self.topology, self.dtype)
        episodes, requests = worlds[: self.episode_words], worlds[self.episode_words :].astype(jnp.int32)
        request, executed = unpack_request(requests, self.slots)
        is_reset = request.stop_step == RESET
        episode = _reset_where(self.topology, world, is_reset, layout.unpack(episodes[first:]))
        request = replace(request, stop_step=jnp.where(is_reset, episode.state.step, request.stop_step))
        episode = run_requests(self.topology, timing, world, request, episode)
        status = status_of(episodes[0].astype(jnp.int32), world, episode, executed)

        def tables() -> tuple[jax.Array, ...]:
            whole, numbers = layout.parts(episode)
            # Row by row: from a few whole arrays the compiler would select for each number.
            words = jnp.concatenate([*(row.astype(worlds.dtype)[None] for row in status_rows(status)), whole])
            sound = status.fault != FAULT_NOT_FINITE  # no policy should meet a NaN
            position = episode.state.position
            pose = Pose(position.x, position.y, episode.state.angle, status.present, sound)
            body_obs = [
                jnp.concatenate(pair)
                for pair in zip(scaled_ends(ends, pose), speeds(episode.state.motion), strict=True)
            ]
            rows = jnp.concatenate(body_obs)
            return words, numbers, jnp.where(sound[None], rows, jnp.zeros_like(rows))

        return in_branch(always, tables)


def _reset_where(topology: Topology, world: World, is_reset: jax.Array, episode: EpisodeState) -> EpisodeState:
    """Return episodes, some of them reset."""

    def fresh() -> EpisodeState:
        start = rollouts.reset_episode(topology, world, jnp.zeros_like(is_reset))
        return jax.tree.map(lambda new, old: jnp.where(jnp.broadcast_to(is_reset, old.shape), new, old), start, episode)

    return jax.lax.cond(jnp.any(is_reset), fresh, lambda: episode)

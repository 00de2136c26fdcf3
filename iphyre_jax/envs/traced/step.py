"""One decision of a group of worlds, inside the user's program; lanes are behind, see `physics.types`.

The tables of all topologies are padded to the largest, which changes nothing: a world is computed as in a batch of its
own topology.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.envs.batching.next_game import NO_GAME, NextGame
from iphyre_jax.envs.batching.play_requests import (
    RunRequests,
    request_words,
    run_requests,
    run_with_few_slots,
    unpack_request,
)
from iphyre_jax.envs.batching.status import GAME, Status, status_of, status_words
from iphyre_jax.envs.traced.episode_rows import EpisodeRows
from iphyre_jax.envs.traced.scene_rows import scene_layouts, scene_of
from iphyre_jax.execution.gpu.one_kernel import blocks_in_one_kernel, in_one_kernel
from iphyre_jax.execution.layout import WORD, Layout, Parts
from iphyre_jax.observations.features import Features, own_features, pose_of
from iphyre_jax.observations.patches import ObsPatch, obs_patch
from iphyre_jax.observations.vectors import ObservationName, ObsInputs, obs_inputs, observation_size, observe
from iphyre_jax.physics.lanes import materialize
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, reset_episode
from iphyre_jax.scenes import Limits


class Episode(NamedTuple):
    """An episode as it is kept, and what an agent sees of it."""

    state: Parts  # (rows,) see `EpisodeRows`
    obs: jax.Array  # (numbers,) float32

    def of_game(self, game: jax.Array) -> Episode:
        """Return it as an episode of a game, () whole number; of lanes behind, (lanes,)."""
        whole = jnp.concatenate([game[None].astype(self.state.whole.dtype), self.state.whole[GAME + 1 :]])
        return self._replace(state=self.state._replace(whole=whole))


class Games(NamedTuple):
    """Tables of games, one a row."""

    topology_id: jax.Array  # (games,) int32
    scenes: Parts  # see `TracedStep.scene_layout`
    start: Episode  # before the first step


class StepInput(NamedTuple):
    """What a world plays next."""

    state: Parts  # of its episode
    request: jax.Array  # (words,) int32, see `pack_request`
    next_game: NextGame  # of the episode that follows if this one ends
    first_game: jax.Array  # () int32, row of the world's game 0

    @property
    def size(self) -> int:
        """Worlds, if each is a row."""
        return self.first_game.shape[0]

    @property
    def row(self) -> jax.Array:
        """Row of the game of each episode, (B,) int32; of many worlds, one a row."""
        return self.first_game + self.state.whole[:, GAME].astype(jnp.int32)


class StepOutput(NamedTuple):
    """What a decision leaves."""

    now: Episode
    status: jax.Array  # (words,) packed, before any reset
    final: tuple[Episode, ...]  # before any reset; empty if not asked for


class PlayedLanes(NamedTuple):
    """Episodes after a decision, lanes behind, before they are observed or begin anew."""

    state: Parts  # as in `Episode`
    inputs: ObsInputs  # of their observations
    follows: jax.Array  # (lanes,) bool, where the next episode follows


class PlayedRows(NamedTuple):
    """The same on a CPU, where observations are rows."""

    state: Parts
    patch: ObsPatch
    follows: jax.Array


@dataclass(frozen=True)
class TracedStep:
    """The decision of an environment. Attributes are those of `Worlds`, and the steps of a whole episode."""

    topologies: tuple[Topology, ...]
    dtype: str
    steps: int
    observation: ObservationName
    limits: Limits
    no_op: bool
    keep_final: bool

    @property
    def status_words(self) -> int:
        """Words of a status."""
        return status_words(self.limits.blocks)

    @property
    def rows(self) -> tuple[int, int]:
        """Rows of the two parts of the largest episode."""
        return _most([self.episode_rows(topology).all for topology in self.topologies])

    @property
    def request_words(self) -> int:
        """Words of a request."""
        return request_words(self.limits.blocks)

    def episode_rows(self, topology: Topology) -> EpisodeRows:
        """Return the rows of an episode of a topology."""
        return EpisodeRows(topology, self.limits.blocks, self.dtype)

    def scene_layout(self, topology: Topology) -> Layout:
        """Return the layout of a scene, see `scene_tree`."""
        return scene_layouts(self.topologies, topology, self.limits, self.dtype)[0]

    def short_scene_layout(self, topology: Topology) -> Layout:
        """Return the layout of what a CPU reads of a scene."""
        return scene_layouts(self.topologies, topology, self.limits, self.dtype)[1]

    @property
    def scene_parts(self) -> tuple[tuple[int, str], ...]:
        """Rows and dtype of the two parts of the largest scene."""
        return tuple(zip(self.scene_rows, (WORD[self.dtype].name, self.dtype), strict=True))

    @property
    def scene_rows(self) -> tuple[int, int]:
        """Rows of the two parts of the largest scene."""
        return _most([self.scene_layout(topology).part_rows for topology in self.topologies])

    def start(self, topology: Topology, scene: Parts) -> Episode:
        """Return episodes of scenes before their first step, lanes behind; their game is 0."""
        lanes = scene.whole.shape[1:]
        features, world = self._scene(topology, scene)
        episode = reset_episode(topology, world, jnp.zeros(lanes, bool))
        executed = jnp.zeros((self.limits.blocks, *lanes), bool)
        status = status_of(jnp.zeros(lanes, jnp.int32), world, episode, executed)
        inputs = self._obs_inputs(features, status, episode)
        state = self.episode_rows(topology).pack(status, episode).padded(self.rows)
        return Episode(state, observe(features, inputs, no_op=self.no_op))

    def play(self, topology: Topology, timing: Timing, scene: Parts, start: Episode, given: StepInput) -> StepOutput:
        """Play one decision of worlds of one topology, lanes behind their rows; for an accelerator.

        Args:
            topology: of the worlds.
            timing: of the physics step.
            scene: of each lane.
            start: the next episodes before their first step.
            given: what is played.
        """
        features, world = self._scene(topology, scene)

        def played() -> PlayedLanes:
            return in_one_kernel(partial(self._played, topology), timing, (features, world, given))

        lanes = materialize(played)
        return materialize(partial(self._output, features, start, given, lanes))

    def play_in_rows(
        self, topology: Topology, timing: Timing, scene: Parts, given: StepInput, *, few_slots: bool
    ) -> PlayedRows:
        """Play one decision of worlds of one topology, lanes behind their rows; for a CPU.

        Args:
            topology: of the worlds.
            timing: of the physics step.
            scene: of each lane, see `short_scene_layout`.
            given: what is played.
            few_slots: see `run_with_few_slots`; faster, but it compiles a step twice.
        """
        features, world = self.short_scene_layout(topology).join(scene)
        features, run = own_features(features, topology), run_with_few_slots if few_slots else run_requests

        def played() -> PlayedRows:
            status, episode, follows = self._decided(topology, run, timing, world, given)
            patch = obs_patch(self.observation, features, status.present, episode, jnp.asarray(self.steps))
            return PlayedRows(self.episode_rows(topology).pack(status, episode), patch, follows)

        return materialize(played)

    def play_blocks(
        self, chosen: jax.Array, timing: Timing, scene: Parts, start: Episode, given: StepInput
    ) -> StepOutput:
        """Do what `play` does, with blocks of lanes, each of a topology of its own, side by side; for a GPU.

        Args:
            chosen: (blocks,) int32, the topology of each block.
            timing: of the physics step.
            scene: of each lane.
            start: the next episodes before their first step.
            given: what is played.
        """
        most = max(topology.moving for topology in self.topologies)

        def played(topology: Topology, timing: Timing, lanes: tuple[Parts, StepInput]) -> PlayedLanes:
            state, inputs, follows = self._played(topology, timing, (*self._scene(topology, lanes[0]), lanes[1]))
            rows = inputs.rows
            blank = [jnp.zeros_like(rows.placed[0])] * (most - topology.moving)  # of bodies that are no object
            placed = inputs._replace(rows=rows._replace(placed=[*rows.placed, *blank]))
            return PlayedLanes(state.padded(self.rows), placed, follows)

        works = [partial(played, topology) for topology in self.topologies]
        features, _ = scene_of(self.scene_layout(self.topologies[0]).join(scene))
        return self._output(features, start, given, blocks_in_one_kernel(works, chosen, timing, (scene, given)))

    def _scene(self, topology: Topology, scene: Parts) -> tuple[Features, World]:
        """Return what observations need of packed scenes of a topology, and their worlds; lanes behind."""
        features, world = scene_of(self.scene_layout(topology).join(scene))
        return own_features(features, topology), world

    def _output(self, features: Features, start: Episode, given: StepInput, played: PlayedLanes) -> StepOutput:
        """Return what a decision leaves; start: see `play`."""
        state = played.state.padded(self.rows)
        final = Episode(state, observe(features, played.inputs, no_op=self.no_op))
        fresh = start.of_game(given.next_game.game)
        now = jax.tree.map(lambda new, old: jnp.where(played.follows[None], new, old), fresh, final)
        return StepOutput(now, state.whole[: self.status_words], (final,) if self.keep_final else ())

    def _played(self, topology: Topology, timing: Timing, lanes: tuple[Features, World, StepInput]) -> PlayedLanes:
        """Return episodes after a decision."""
        features, world, given = lanes
        status, episode, follows = self._decided(topology, run_requests, timing, world, given)
        inputs = self._obs_inputs(features, status, episode)
        return PlayedLanes(self.episode_rows(topology).pack(status, episode), inputs, follows)

    def _decided(
        self, topology: Topology, run: RunRequests, timing: Timing, world: World, given: StepInput
    ) -> tuple[Status, EpisodeState, jax.Array]:
        """Return status and episode after a decision, and where the next episode follows, (lanes,) bool."""
        request, executed = unpack_request(given.request, self.limits.blocks)
        status, episode = self.episode_rows(topology).join(given.state)
        episode = run(topology, timing, world, request, episode)
        status = status_of(status.game, world, episode, executed)
        ended = status.success | (status.fault != 0) | (status.step >= self.steps)
        return status, episode, ended & (given.next_game.game != NO_GAME)

    def blank(self, size: int) -> StepOutput:
        """Return zeros in the place of what decisions of so many worlds leave."""
        word = WORD[self.dtype]
        rows, numbers = self.rows
        obs = observation_size(self.observation, self.limits.objects, self.limits.blocks + self.no_op)
        state = Parts(jnp.zeros((size, rows), word), jnp.zeros((size, numbers), self.dtype))
        episode = Episode(state, jnp.zeros((size, obs), jnp.float32))
        return StepOutput(episode, jnp.zeros((size, self.status_words), word), (episode,) if self.keep_final else ())

    def _obs_inputs(self, features: Features, status: Status, episode: EpisodeState) -> ObsInputs:
        pose, bodies = pose_of(features, status.present, episode), episode.state.motion
        return obs_inputs(self.observation, features, pose, bodies, status.step, jnp.asarray(self.steps))


def _most(rows: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Return the most rows of the two parts of tables."""
    whole, numbers = zip(*rows, strict=True)
    return max(whole), max(numbers)

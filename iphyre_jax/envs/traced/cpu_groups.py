"""Groups of worlds of one topology on a CPU, inside the user's program.

A group reads the rows of its worlds, plays, and writes them where they were; other rows are not touched.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax.envs.batching.next_game import NextGame
from iphyre_jax.envs.batching.status import GAME
from iphyre_jax.envs.traced.episode_rows import EpisodeRows
from iphyre_jax.envs.traced.step import Episode, Games, PlayedRows, StepInput, StepOutput, TracedStep
from iphyre_jax.execution.layout import Parts, read_columns, write_columns, write_transposed
from iphyre_jax.observations.patches import write_observations
from iphyre_jax.physics.lanes import if_any, read, visit_any, write
from iphyre_jax.physics.types import Timing, Topology


class Given(NamedTuple):
    """What a batch plays, one world a row; its states apart, which change in place."""

    timing: Timing
    games: Games
    game_count: jax.Array  # () int32, rows of `games`; its arrays may be declared longer, see `TopologyStep`
    order: jax.Array  # (B,) int32, the worlds sorted by topology and game
    request: jax.Array  # (B, words) int32, see `StepInput`
    next_game: NextGame  # of each world
    first_game: jax.Array  # (B,) int32


@dataclass(frozen=True)
class Group:
    """The worlds of one topology that are played side by side."""

    world: jax.Array  # (lanes,) int32, the world that each lane plays; spare lanes play the last one again
    count: jax.Array  # () int32, lanes that are not spare, the first ones
    neighbours: bool  # whether the worlds follow each other in the batch, and no lane is spare

    def read(self, table: jax.Array, width: int, column: int = 0) -> jax.Array:
        """Return so many columns of the worlds' rows, (width, lanes); table: (B, columns)."""
        if not self.neighbours:
            return read_columns(table, self.world, width, column)
        return jax.lax.dynamic_slice(table, (self.world[0], jnp.int32(column)), (self.world.shape[0], width)).T

    def write(self, lanes: jax.Array, table: jax.Array, column: int = 0) -> jax.Array:
        """Return a table, (B, columns), with what is in lanes, (width, lanes), in columns of the worlds."""
        if not self.neighbours:
            return write_columns(lanes, table, self.world, self.count, column)
        return write_transposed(lanes, table, self.world[0], column)


def play_group(
    step: TracedStep,
    topology: Topology,
    lanes: int,
    neighbours: bool,
    few_slots: bool,
    batch: Given,
    last: jax.Array,
    first: jax.Array,
    out: StepOutput,
) -> StepOutput:
    """Play the next worlds of a topology.

    Args:
        step: what is played.
        topology: of the worlds.
        lanes: worlds side by side.
        neighbours: see `Group`.
        few_slots: see `TracedStep.play_in_rows`.
        batch: what is played.
        last: () int32, the place in the order after the last world of the topology.
        first: () int32, the place of the first world to play.
        out: the states of all worlds before the decision; receives what the group leaves.
    """
    games = batch.games
    at = jnp.minimum(first + jnp.arange(lanes, dtype=jnp.int32), last - 1)
    world = batch.order.at[at].get(mode="promise_in_bounds")
    group = Group(world, jnp.minimum(lanes, last - first), neighbours)
    given = _read(step, topology, batch, group, out.now.state)
    row = row_of(batch.game_count, given.first_game + given.state.whole[GAME].astype(jnp.int32))
    played = step.play_in_rows(topology, batch.timing, _scenes(step, topology, games, row), given, few_slots=few_slots)
    out = _write(step, topology, group, (games, row), (given, played), out)
    follows = played.follows & (jnp.arange(lanes) < group.count)
    return out._replace(now=begin(out.now, batch, follows, world))


def row_of(game_count: jax.Array | int, row: jax.Array) -> jax.Array:
    """Return rows of the table of games; an episode of other parameters may name one that is not there."""
    return jnp.clip(row, 0, game_count - 1)


def _read(step: TracedStep, topology: Topology, batch: Given, group: Group, states: Parts) -> StepInput:
    """Return what the worlds of a group play, lanes behind."""
    state = _read_state(step.episode_rows(topology), group, states)
    request = group.read(batch.request, batch.request.shape[1])
    game, first = (
        part.at[group.world].get(mode="promise_in_bounds") for part in (batch.next_game.game, batch.first_game)
    )
    return StepInput(state, request, NextGame(game), first)


def _read_state(rows: EpisodeRows, group: Group, states: Parts) -> Parts:
    """Return the episodes of a group, (rows, lanes). Further contact slots are read if one of them uses some."""
    usual = Parts(*map(group.read, states, rows.usual))
    further = [last - first for first, last in zip(rows.usual, rows.all, strict=True)]

    def read_further() -> Parts:
        return Parts(*map(group.read, states, further, rows.usual))

    def none() -> Parts:
        blank = Parts(*(part[:0] for part in usual)).padded((further[0], further[1]))
        return blank._replace(whole=blank.whole - 1)  # an empty slot

    # Not by `if_any`: XLA would take what does not change out of a loop.
    read = jax.lax.cond(jnp.any(rows.is_crowded(usual.whole)), read_further, none)
    return jax.tree.map(lambda first, more: jnp.concatenate([first, more]), usual, read)


def _write(
    step: TracedStep,
    topology: Topology,
    group: Group,
    of_games: tuple[Games, jax.Array],
    lanes: tuple[StepInput, PlayedRows],
    out: StepOutput,
) -> StepOutput:
    """Return what a group leaves, written into the rows of its worlds, before any of them begins anew.

    Args:
        step: what is played.
        topology: of the worlds.
        group: of them.
        of_games: the table of games, and the row of each lane's game.
        lanes: the episodes before and after the decision.
        out: receives what is left.
    """
    (games, row), (given, played), rows = of_games, lanes, step.episode_rows(topology)

    def observed(obs: jax.Array) -> jax.Array:
        own = group.world, group.count, games.start.obs, row, played.patch, step.limits.objects
        return write_observations(obs, *own)

    now = Episode(_write_state(rows, group, given.state, played.state, out.now.state), observed(out.now.obs))
    status = group.write(played.state.whole[: step.status_words], out.status)
    final = (Episode(jax.tree.map(group.write, played.state, one.state), observed(one.obs)) for one in out.final)
    return StepOutput(now, status, tuple(final))


def _write_state(rows: EpisodeRows, group: Group, before: Parts, after: Parts, states: Parts) -> Parts:
    """Return states with the episodes of a group; further contact slots if one of them uses some, or did before."""
    usual = (part[:width] for part, width in zip(after, rows.usual, strict=True))
    states = Parts(*map(group.write, usual, states))

    def write_further(states: Parts) -> Parts:
        further = (part[width:] for part, width in zip(after, rows.usual, strict=True))
        return Parts(*map(group.write, further, states, rows.usual))

    return if_any(rows.is_crowded(before.whole) | rows.is_crowded(after.whole), write_further, states)


def _scenes(step: TracedStep, topology: Topology, games: Games, row: jax.Array) -> Parts:
    """Return the scenes of lanes, (rows, lanes), see `short_scene_layout`; row: (lanes,) of the table of games.

    Of few games each is looked up once, and put into all of its lanes.
    """
    widths, rows = step.short_scene_layout(topology).part_rows, step.scene_layout(topology).part_rows
    columns = [every - width for every, width in zip(rows, widths, strict=True)]  # behind what is not read
    count, lanes = games.topology_id.shape[0], len(row)
    if count > lanes:  # each lane may have a game of its own
        parts = zip(games.scenes, widths, columns, strict=True)
        return Parts(*(read_columns(part, row, width, column) for part, width, column in parts))

    def of_game(game: jax.Array) -> tuple[jax.Array, ...]:
        parts = zip(read(games.scenes, game), widths, columns, strict=True)
        own = (part[column : column + width, None] for part, width, column in parts)
        return tuple(jnp.broadcast_to(part, (part.shape[0], lanes)) for part in own)

    if count == 1:
        return Parts(*of_game(jnp.int32(0)))

    def fill(carry: tuple[jax.Array, tuple[jax.Array, ...]]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
        left, scenes = carry
        game = jnp.max(jnp.where(left, row, 0))
        here = row == game
        return left & ~here, jax.tree.map(lambda new, old: jnp.where(here[None], new, old), of_game(game), scenes)

    game = row[0]
    _, scenes = jax.lax.while_loop(lambda carry: jnp.any(carry[0]), fill, (row != game, of_game(game)))
    return Parts(*scenes)


def begin(now: Episode, batch: Given, follows: jax.Array, world: jax.Array) -> Episode:
    """Return episodes, one a row, some of them begun: their rows, and nothing else, are replaced.

    Args:
        now: episodes.
        batch: what is played.
        follows: (lanes,) bool, where the next game begins.
        world: (lanes,) int32, row of each lane's episode.
    """

    def copy(lane: jax.Array, now: Episode) -> Episode:
        next_game, first_game = read((batch.next_game, batch.first_game), world[lane])
        game = next_game.row()
        start = read(batch.games.start, first_game + game)
        return write(now, world[lane], start.of_game(game))

    return visit_any(follows, copy, now)

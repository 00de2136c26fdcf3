"""One decision of a batch of worlds of several topologies on a CPU, inside the user's program.

Worlds are sorted by topology and game, and played in groups of lanes of one topology. Each group is one function of
machine code. It reads the rows of its worlds, plays, and writes them where they were; other rows are not touched.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.tree_util import PyTreeDef

from iphyre_jax.envs.batching.status import GAME
from iphyre_jax.envs.traced.sorting import one_game, sort_by_game
from iphyre_jax.envs.traced.step import Episode, Games, StepInput, StepOutput, TracedStep
from iphyre_jax.execution.devices import LANES, cpu_lanes
from iphyre_jax.execution.layout import Parts, read_columns, write_columns, write_transposed
from iphyre_jax.execution.one_function import in_branch, in_one_function
from iphyre_jax.execution.programs import episode_layout
from iphyre_jax.physics.lanes import read, visit_any, write
from iphyre_jax.physics.types import Timing, Topology

# Returns work(*arguments, *in_place), see `in_one_function`.
Call = Callable[..., StepOutput]


class Given(NamedTuple):
    """What a batch plays, one world a row; its states apart, which change in place."""

    timing: Timing
    games: Games
    order: jax.Array  # (B,) int32, the worlds sorted by topology and game
    request: jax.Array  # (B, words) int32, see `StepInput`
    next_game: jax.Array  # (B,) int32
    first_game: jax.Array  # (B,) int32


@dataclass(frozen=True)
class Group:
    """The worlds of one topology that are played side by side."""

    world: jax.Array  # (lanes,) int32, the world that each lane plays; spare lanes play the last one again
    count: jax.Array  # () int32, lanes that are not spare, the first ones
    neighbours: bool  # whether the worlds follow each other in the batch, and no lane is spare

    def read(self, table: jax.Array, width: int) -> jax.Array:
        """Return the first columns of the worlds' rows, (width, lanes); table: (B, columns)."""
        if not self.neighbours:
            return read_columns(table, self.world, width)
        return jax.lax.dynamic_slice(table, (self.world[0], jnp.int32(0)), (self.world.shape[0], width)).T

    def write(self, lanes: jax.Array, table: jax.Array) -> jax.Array:
        """Return a table, (B, columns), with what is in lanes, (width, lanes), in the first columns of the worlds."""
        if not self.neighbours:
            return write_columns(lanes, table, self.world, self.count)
        return write_transposed(lanes, table, self.world[0])


def plain(work: Call, *arguments: Any, in_place: tuple[StepOutput, ...] = ()) -> StepOutput:  # noqa: ANN401 - trees
    """Return work(*arguments, *in_place), for programs that need derivatives."""
    return work(*arguments, *in_place)


def play_on_cpu(step: TracedStep, call: Call, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `batch.decide` says. What a state has behind the columns of its topology stays.

    Args:
        step: what is played.
        call: `in_one_function`, or `plain`.
        shared: timing and games.
        given: one world a row.
    """
    (timing, games), size, topologies = shared, given.next_game.shape[0], len(step.topologies)
    if not size:
        return step.blank(0)
    # A function must read each of its arguments (`in_one_function`). So no group may overwrite a whole table.
    spare_rows = 1 if size <= LANES else 0
    out = step.blank(size + spare_rows)
    state = given.state.padded((size + spare_rows, size + spare_rows))
    out = out._replace(now=out.now._replace(state=state))
    order, last = sort_by_game(games.topology_id, _row_of(games, given.row), topologies)
    # What the compiler knows of the batch it must not use: it would take loops and tables apart, see above.
    last = jnp.where(timing.dt > 0, last, 0)
    batch = Given(timing, games, order, given.request, given.next_game, given.first_game)
    # Rows of worlds that follow each other are read as one.
    whole_groups = one_game(games.topology_id, topologies) and (size <= LANES or not size % LANES)
    for k, topology in enumerate(step.topologies):
        first = last[k - 1] if k else jnp.int32(0)
        lanes = min(size, LANES if whole_groups else cpu_lanes(topology, size, topologies))
        play = partial(call, partial(_play_group, step, topology, lanes), batch, last[k])
        if lanes == size and whole_groups:
            # XLA removes a loop of one turn, and if a device plays a part of the worlds, it inlines calls that stand
            # outside of loops and branches.
            out = in_branch(timing.dt > 0, partial(play, first, out))
            break

        def play_next(
            number: jax.Array, out: StepOutput, play: Call = play, first: jax.Array = first, lanes: int = lanes
        ) -> StepOutput:
            return play(first + number * lanes, in_place=(out,))

        out = jax.lax.fori_loop(0, (last[k] - first + lanes - 1) // lanes, play_next, out)
    return jax.tree.map(lambda leaf: leaf[:size], out) if spare_rows else out


def play_when_lowered(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `play_on_cpu` does, each group in one function; it is traced where the program is lowered.

    So a batch is traced once. For `custom_vmap`, which asks one of its worlds for shapes first, they are told untraced.
    """
    leaves, structure = jax.tree.flatten((shared, given))
    played = _play_on_cpu.bind(*leaves, step=step, structure=structure)
    return jax.tree.unflatten(jax.tree.structure(_shapes(step, given.next_game.shape[0])), played)


@lru_cache(256)
def _shapes(step: TracedStep, size: int) -> StepOutput:
    """Return the shapes of what decisions of so many worlds leave."""
    with jax.enable_x64(step.dtype == "float64"):
        return jax.eval_shape(partial(step.blank, size))


def _avals(*leaves: Any, step: TracedStep, structure: PyTreeDef) -> list[ShapedArray]:  # noqa: ANN401 - their shapes
    _, given = jax.tree.unflatten(structure, leaves)
    return [ShapedArray(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(_shapes(step, given.next_game.shape[0]))]


@partial(jax.jit, static_argnames=("step", "structure"))
def _play(*leaves: jax.Array, step: TracedStep, structure: PyTreeDef) -> list[jax.Array]:
    return jax.tree.leaves(play_on_cpu(step, in_one_function, *jax.tree.unflatten(structure, leaves)))


def _play_traced(*leaves: jax.Array, step: TracedStep, structure: PyTreeDef) -> list[jax.Array]:
    """Play, whatever JAX is set to where the program is lowered; `jax.disable_jit` takes no primitive apart."""
    with jax.enable_x64(step.dtype == "float64"), jax.disable_jit(False):
        return _play(*leaves, step=step, structure=structure)


_play_on_cpu = Primitive("play_on_cpu")
_play_on_cpu.multiple_results = True
_play_on_cpu.def_abstract_eval(_avals)
_play_on_cpu.def_impl(_play_traced)
mlir.register_lowering(_play_on_cpu, mlir.lower_fun(_play_traced, multiple_results=True))


def _play_group(
    step: TracedStep,
    topology: Topology,
    lanes: int,
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
        batch: what is played.
        last: () int32, the place in the order after the last world of the topology.
        first: () int32, the place of the first world to play.
        out: the states of all worlds before the decision; receives what the group leaves.
    """
    games, size = batch.games, len(batch.order)
    at = jnp.minimum(first + jnp.arange(lanes, dtype=jnp.int32), last - 1)
    world = batch.order.at[at].get(mode="promise_in_bounds")
    neighbours = one_game(games.topology_id, len(step.topologies)) and not size % lanes
    group = Group(world, jnp.minimum(lanes, last - first), neighbours)
    given = _read(step, topology, batch, group, out.now.state)
    row = _row_of(games, given.first_game + given.state.whole[GAME].astype(jnp.int32))
    tables, follows = step.play(topology, batch.timing, _scenes(step, topology, games, row), None, given)
    out = jax.tree.map(group.write, tables, out)
    follows = follows & (jnp.arange(lanes) < group.count)
    return out._replace(now=begin(out.now, games.start, given, follows, world))


def _row_of(games: Games, row: jax.Array) -> jax.Array:
    """Return rows of the table of games; an episode of other parameters may name one that is not there."""
    return jnp.clip(row, 0, games.topology_id.shape[0] - 1)


def _read(step: TracedStep, topology: Topology, batch: Given, group: Group, states: Parts) -> StepInput:
    """Return what the worlds of a group play, lanes behind; states have no more rows than the topology needs."""
    whole, numbers = episode_layout(topology, step.dtype).part_rows
    state = Parts(group.read(states.whole, step.status_words + whole), group.read(states.numbers, numbers))
    request = group.read(batch.request, batch.request.shape[1])
    own = (rows.at[group.world].get(mode="promise_in_bounds") for rows in (batch.next_game, batch.first_game))
    return StepInput(state, request, *own)


def _scenes(step: TracedStep, topology: Topology, games: Games, row: jax.Array) -> Parts:
    """Return the scenes of lanes, (rows, lanes); row: (lanes,) of the table of games.

    Of few games each is looked up once, and put into all of its lanes.
    """
    widths, tables = step.scene_layout(topology).part_rows, games.scenes
    count, lanes = games.topology_id.shape[0], len(row)
    if count > lanes:  # each lane may have a game of its own
        return Parts(*(read_columns(part, row, width) for part, width in zip(tables, widths, strict=True)))

    def of_game(game: jax.Array) -> tuple[jax.Array, ...]:
        parts = zip(read(tables, game), widths, strict=True)
        return tuple(jnp.broadcast_to(part[:width, None], (width, lanes)) for part, width in parts)

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


def begin(now: Episode, starts: Episode, given: StepInput, follows: jax.Array, world: jax.Array) -> Episode:
    """Return episodes, one a row, some of them begun: their rows, and nothing else, are replaced.

    Args:
        now: episodes.
        starts: of all games, before their first step.
        given: of the lanes.
        follows: (lanes,) bool, where the next game begins.
        world: (lanes,) int32, row of each lane's episode.
    """

    def copy(lane: jax.Array, now: Episode) -> Episode:
        game = given.next_game[lane]
        start = read(starts, given.first_game[lane] + game)
        return write(now, world[lane], start.of_game(game))

    return visit_any(follows, copy, now)

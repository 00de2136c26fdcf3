"""One decision of a batch of worlds of several topologies, inside the user's program.

A topology decides what is compiled. So a batch is sorted by topology and played in groups of lanes, each by the code of
its topology (`traced.step`): one after the other, or on an NVIDIA GPU all side by side. A batch has rules of its own
for `jax.vmap`, for derivatives and for several devices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from iphyre_jax.envs.traced.sorting import run_slices, run_sorted, sort_into_blocks
from iphyre_jax.envs.traced.step import Episode, Games, StepInput, StepOutput, TracedStep
from iphyre_jax.execution.devices import MOST_OF_DEVICE, on_cpu, traced_lanes
from iphyre_jax.execution.gpu import one_kernel
from iphyre_jax.execution.gpu.one_kernel import BLOCK, NoKernelError
from iphyre_jax.execution.layout import write_transposed
from iphyre_jax.execution.one_function import in_branch, in_one_function
from iphyre_jax.execution.rowwise import rowwise
from iphyre_jax.physics.lanes import any_lane, any_set, read, take_first, write
from iphyre_jax.physics.types import Timing, Topology

Decide = Callable[[Timing, Games, StepInput], StepOutput]


def decide(step: TracedStep, timing: Timing, games: Games, given: StepInput) -> StepOutput:
    """Play one decision of a batch.

    Args:
        step: what is played.
        timing: of the physics step; the same for all worlds of a batch.
        games: of all worlds.
        given: one world a row.
    """
    return _differentiable(step)(timing, games, given)


@lru_cache(64)
def _differentiable(step: TracedStep) -> Decide:
    """Return `_vmappable` with its own derivative, that of the plain program."""
    decide = jax.custom_jvp(_vmappable(step))

    @decide.defjvp
    def derivative(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[StepOutput, StepOutput]:
        def plain(timing: Timing, games: Games, given: StepInput) -> StepOutput:
            return _play_batch(step, lambda work, *arguments: work(*arguments), (timing, games), given)

        both: tuple[StepOutput, StepOutput] = jax.jvp(plain, primals, tangents)
        return both

    return decide


def _vmappable(step: TracedStep) -> Decide:
    """Return `_play_batch` with its own rule for `jax.vmap`: axes in front join that of the batch."""

    @custom_vmap
    @jax.jit
    def decide(timing: Timing, games: Games, given: StepInput) -> StepOutput:
        if one_kernel.kernels_run() and len(step.topologies) > 1:
            with suppress(NoKernelError):
                return rowwise(partial(_play_blocks, step), (timing, games), given)
        return rowwise(partial(_play_batch, step, in_one_function), (timing, games), given)

    @decide.def_vmap
    def batched(
        size: int, mapped: Sequence[object], timing: Timing, games: Games, given: StepInput
    ) -> tuple[StepOutput, StepOutput]:
        if any(jax.tree.leaves(mapped[0])):
            raise ValueError("timing: expected the same for all worlds of a batch, got one that is mapped over")

        def with_axis(leaf: jax.Array, has_axis: bool) -> jax.Array:
            return leaf if has_axis else jnp.broadcast_to(leaf, (size, *leaf.shape))

        def without_axis(leaf: jax.Array) -> jax.Array:
            return leaf.reshape(size * leaf.shape[1], *leaf.shape[2:])

        given = jax.tree.map(with_axis, given, mapped[2])
        if any(jax.tree.leaves(mapped[1])):  # each world has games of its own: stack them
            games = jax.tree.map(with_axis, games, mapped[1])
            first = games.topology_id.shape[1] * jnp.arange(size, dtype=jnp.int32)
            given = given._replace(first_game=given.first_game + first[:, None])
            games = jax.tree.map(without_axis, games)
        each = given.next_game.shape[1]
        out = decide(timing, games, jax.tree.map(without_axis, given))
        out = jax.tree.map(lambda leaf: leaf.reshape(size, each, *leaf.shape[1:]), out)
        return out, jax.tree.map(lambda _: True, out)

    return decide


def _play_batch(
    step: TracedStep, call: Callable[..., StepOutput], shared: tuple[Timing, Games], given: StepInput
) -> StepOutput:
    """Do what `decide` says; call(work, *arguments) returns what work(*arguments) does."""
    (timing, games), size = shared, given.next_game.shape[0]
    if not size:
        return step.blank(0)
    lanes, is_single = traced_lanes(size, len(step.topologies)), games.topology_id.shape[0] == 1
    # To gather and turn over what few lanes need costs a CPU more than to copy it row by row.
    by_rows = on_cpu() and not is_single

    def play(
        topology: Topology, timing: Timing, games: Games, given: StepInput, out: StepOutput, first: jax.Array
    ) -> StepOutput:
        """Play worlds of one topology, one a row, and write what they leave into `out`, from row `first` on."""

        def rows_of(table: jax.Array, game: jax.Array) -> jax.Array:
            if is_single:  # no lookup: all lanes play the one game
                return jnp.broadcast_to(table[0][:, None], (table.shape[1], lanes))
            return table.at[game].get(mode="clip").T

        scene = jax.tree.map(partial(rows_of, game=given.row), games.scenes)
        next_row = given.first_game + given.next_game
        start = None if by_rows else jax.tree.map(partial(rows_of, game=next_row), games.start)
        tables, follows = step.play(topology, timing, scene, start, jax.tree.map(jnp.transpose, given))
        out = jax.tree.map(lambda table, rows: write_transposed(table, rows, first), tables, out)
        return out._replace(now=_begin(out.now, games.start, given, follows, first)) if by_rows else out

    branches = [partial(play, topology) for topology in step.topologies]
    if len(branches) > 1:
        own = [partial(call, branch, timing, games) for branch in branches]
        return run_sorted(own, lanes, games.topology_id[given.row], given, step.blank(size))

    def run(timing: Timing, games: Games, given: StepInput) -> StepOutput:
        return run_slices(partial(branches[0], timing, games), lanes, given, step.blank(size))

    # In a branch: if a device plays a part of the worlds, XLA inlines calls that stand outside of loops and branches.
    return in_branch(timing.dt > 0, lambda: call(run, timing, games, given))


def _play_blocks(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `decide` says, on a GPU: the worlds of all topologies side by side, in blocks of one each."""
    (timing, games), size = shared, given.next_game.shape[0]
    if not size:
        return step.blank(0)

    def play(given: StepInput, out: StepOutput, first: jax.Array) -> StepOutput:
        blocks = sort_into_blocks(games.topology_id[given.row], len(step.topologies), BLOCK)
        lanes = jax.tree.map(lambda leaf: leaf.at[blocks.read].get(mode="promise_in_bounds"), given)

        def of_games(table: Any, game: jax.Array) -> Any:  # noqa: ANN401 - trees of arrays
            return jax.tree.map(lambda leaf: leaf.at[game].get(mode="clip").T, table)

        scene, start = of_games(games.scenes, lanes.row), of_games(games.start, lanes.first_game + lanes.next_game)
        played = step.play_blocks(blocks.topology_id, timing, scene, start, jax.tree.map(jnp.transpose, lanes))
        rows = jax.tree.map(lambda leaf: leaf.T.at[blocks.place].get(mode="promise_in_bounds"), played)
        return jax.tree.map(lambda leaf, own: jax.lax.dynamic_update_slice_in_dim(leaf, own, first, 0), out, rows)

    return run_slices(play, min(size, MOST_OF_DEVICE), given, step.blank(size))


def _begin(now: Episode, starts: Episode, given: StepInput, follows: jax.Array, first: jax.Array) -> Episode:
    """Return episodes, one a row, some of them begun.

    Args:
        now: episodes; those of the lanes begin at row `first`.
        starts: of all games, before their first step.
        given: of the lanes.
        follows: (lanes,) bool, where the next game begins.
        first: () int32.
    """

    def copy(carry: tuple[tuple[jax.Array, ...], Episode]) -> tuple[tuple[jax.Array, ...], Episode]:
        lane, left = take_first(carry[0])
        game = given.next_game[lane]
        start = read(starts, given.first_game[lane] + game)
        return left, write(carry[1], first + lane, start.of_game(game))

    return jax.lax.while_loop(lambda carry: any_set(carry[0]), copy, (any_lane(follows), now))[1]

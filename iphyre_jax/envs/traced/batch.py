"""One decision of a batch of worlds of several topologies, inside the user's program.

A topology decides what is compiled. So a batch is sorted by topology and played in groups of lanes, each by the code of
its topology (`traced.step`): on a CPU by `cpu_batch`, on an NVIDIA GPU all side by side, elsewhere one after the other.
A batch has rules of its own for `jax.vmap`, for derivatives and for several devices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from iphyre_jax.envs.traced.cpu_batch import plain, play_on_cpu, play_when_lowered
from iphyre_jax.envs.traced.sorting import run_slices, run_sorted, sort_into_blocks
from iphyre_jax.envs.traced.step import Games, StepInput, StepOutput, TracedStep
from iphyre_jax.execution.devices import MOST_OF_DEVICE, accelerator_lanes, on_cpu
from iphyre_jax.execution.gpu import one_kernel
from iphyre_jax.execution.gpu.one_kernel import BLOCK, NoKernelError
from iphyre_jax.execution.layout import write_transposed
from iphyre_jax.execution.rowwise import rowwise
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
        def play(timing: Timing, games: Games, given: StepInput) -> StepOutput:
            if on_cpu():
                return play_on_cpu(step, plain, (timing, games), given)
            return _play_groups(step, (timing, games), given)

        both: tuple[StepOutput, StepOutput] = jax.jvp(play, primals, tangents)
        return both

    return decide


def _vmappable(step: TracedStep) -> Decide:
    """Return the decision with its own rule for `jax.vmap`: axes in front join that of the batch."""

    @custom_vmap
    @jax.jit
    def decide(timing: Timing, games: Games, given: StepInput) -> StepOutput:
        if on_cpu():
            return rowwise(partial(play_when_lowered, step), (timing, games), given)
        if one_kernel.kernels_run() and len(step.topologies) > 1:
            with suppress(NoKernelError):
                return rowwise(partial(_play_blocks, step), (timing, games), given)
        return rowwise(partial(_play_groups, step), (timing, games), given)

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
        each = given.first_game.shape[1]
        out = decide(timing, games, jax.tree.map(without_axis, given))
        out = jax.tree.map(lambda leaf: leaf.reshape(size, each, *leaf.shape[1:]), out)
        return out, jax.tree.map(lambda _: True, out)

    return decide


def _play_groups(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `decide` says, on an accelerator: group by group."""
    (timing, games), size = shared, given.size
    if not size:
        return step.blank(0)
    given = given._replace(next_game=given.next_game.drawn())
    lanes, is_single = accelerator_lanes(size, len(step.topologies)), games.topology_id.shape[0] == 1

    def play(topology: Topology, given: StepInput, out: StepOutput, first: jax.Array) -> StepOutput:
        """Play worlds of one topology, one a row, and write what they leave into `out`, from row `first` on."""

        def rows_of(table: jax.Array, game: jax.Array) -> jax.Array:
            if is_single:  # no lookup: all lanes play the one game
                return jnp.broadcast_to(table[0][:, None], (table.shape[1], lanes))
            return table.at[game].get(mode="clip").T

        scene = jax.tree.map(partial(rows_of, game=given.row), games.scenes)
        start = jax.tree.map(partial(rows_of, game=given.first_game + given.next_game.game), games.start)
        tables = step.play(topology, timing, scene, start, jax.tree.map(jnp.transpose, given))
        return jax.tree.map(lambda table, rows: write_transposed(table, rows, first), tables, out)

    branches = [partial(play, topology) for topology in step.topologies]
    if len(branches) == 1:
        return run_slices(branches[0], lanes, given, step.blank(size))
    return run_sorted(branches, lanes, games.topology_id[given.row], given, step.blank(size))


def _play_blocks(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `decide` says, on a GPU: the worlds of all topologies side by side, in blocks of one each."""
    (timing, games), size = shared, given.size
    if not size:
        return step.blank(0)
    given = given._replace(next_game=given.next_game.drawn())

    def play(given: StepInput, out: StepOutput, first: jax.Array) -> StepOutput:
        blocks = sort_into_blocks(games.topology_id[given.row], len(step.topologies), BLOCK)
        lanes = jax.tree.map(lambda leaf: leaf.at[blocks.read].get(mode="promise_in_bounds"), given)

        def of_games(table: Any, game: jax.Array) -> Any:  # noqa: ANN401 - trees of arrays
            return jax.tree.map(lambda leaf: leaf.at[game].get(mode="clip").T, table)

        scene, start = of_games(games.scenes, lanes.row), of_games(games.start, lanes.first_game + lanes.next_game.game)
        played = step.play_blocks(blocks.topology_id, timing, scene, start, jax.tree.map(jnp.transpose, lanes))
        rows = jax.tree.map(lambda leaf: leaf.T.at[blocks.place].get(mode="promise_in_bounds"), played)
        return jax.tree.map(lambda leaf, own: jax.lax.dynamic_update_slice_in_dim(leaf, own, first, 0), out, rows)

    return run_slices(play, min(size, MOST_OF_DEVICE), given, step.blank(size))

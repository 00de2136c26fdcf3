"""One decision of a batch of worlds of several topologies on a CPU, inside the user's program.

Worlds are sorted by topology and game, and played in groups of lanes of one topology. All groups of a topology are one
program that is compiled apart (`play_linked`). Where none can be linked, each group is one function of the user's
program (`play_on_cpu`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import mlir
from jax.tree_util import PyTreeDef

from iphyre_jax.envs.traced.cpu_groups import Given, play_group, row_of
from iphyre_jax.envs.traced.sorting import one_game, sort_by_game
from iphyre_jax.envs.traced.step import Games, StepInput, StepOutput, TracedStep
from iphyre_jax.envs.traced.step_program import linked_steps
from iphyre_jax.execution.devices import LANES, cpu_lanes
from iphyre_jax.execution.machine_code.linked import LinkedProgram
from iphyre_jax.execution.one_function import in_branch, in_one_function
from iphyre_jax.physics.types import Timing

# Returns work(*arguments, *in_place), see `in_one_function`.
Call = Callable[..., StepOutput]


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
    (timing, games), size, topologies = shared, given.size, len(step.topologies)
    if not size:
        return step.blank(0)
    # A function must read each of its arguments (`in_one_function`). So no group may overwrite a whole table.
    spare_rows = 1 if size <= LANES else 0
    out = step.blank(size + spare_rows)
    state = given.state.padded((size + spare_rows, size + spare_rows))
    out = out._replace(now=out.now._replace(state=state))
    batch, last = _sorted_batch(step, shared, given)
    # What the compiler knows of the batch it must not use: it would take loops and tables apart, see above.
    last = jnp.where(timing.dt > 0, last, 0)
    # Rows of worlds that follow each other are read as one.
    alone = one_game(games.topology_id.shape[0], topologies)
    whole_groups = alone and (size <= LANES or not size % LANES)
    for k, topology in enumerate(step.topologies):
        first = last[k - 1] if k else jnp.int32(0)
        lanes = min(size, LANES if whole_groups else cpu_lanes(topology, size, topologies))
        play = partial(
            call, partial(play_group, step, topology, lanes, alone and not size % lanes, False), batch, last[k]
        )
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


def play_linked(
    programs: Sequence[LinkedProgram], step: TracedStep, shared: tuple[Timing, Games], given: StepInput
) -> StepOutput:
    """Do what `play_on_cpu` does, the worlds of each topology by a program that is compiled apart."""
    if not (size := given.size):
        return step.blank(0)
    batch, last = _sorted_batch(step, shared, given)
    out = _shapes(step, size)  # what is not replaced below is only written
    final = tuple(one._replace(state=jax.tree.map(jnp.zeros_like, given.state)) for one in out.final)
    out = out._replace(now=out.now._replace(state=given.state), final=final)
    leaves, structure = jax.tree.flatten(out)
    for k, play in enumerate(programs):
        first = last[k - 1] if k else jnp.zeros_like(last[k])
        leaves = play(*jax.tree.leaves((batch, first, last[k])), *leaves)
    return jax.tree.unflatten(structure, leaves)


def _sorted_batch(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> tuple[Given, jax.Array]:
    """Return what is played, and the place after each topology's last world."""
    timing, games = shared
    count = games.topology_id.shape[0]
    order, last = sort_by_game(games.topology_id, row_of(count, given.row), len(step.topologies))
    next_game = given.next_game.with_keys()
    return Given(timing, games, jnp.int32(count), order, given.request, next_game, given.first_game), last


def play_when_lowered(step: TracedStep, shared: tuple[Timing, Games], given: StepInput) -> StepOutput:
    """Do what `play_on_cpu` does, each group in one function; it is traced where the program is lowered.

    So a batch is traced once. For `custom_vmap`, which asks one of its worlds for shapes first, they are told untraced.
    """
    leaves, structure = jax.tree.flatten((shared, given))
    played = _play_on_cpu.bind(*leaves, step=step, structure=structure)
    return jax.tree.unflatten(jax.tree.structure(_shapes(step, given.size)), played)


@lru_cache(256)
def _shapes(step: TracedStep, size: int) -> StepOutput:
    """Return the shapes of what decisions of so many worlds leave."""
    with jax.enable_x64(step.dtype == "float64"):
        return jax.eval_shape(partial(step.blank, size))


def _avals(*leaves: Any, step: TracedStep, structure: PyTreeDef) -> list[ShapedArray]:  # noqa: ANN401 - their shapes
    _, given = jax.tree.unflatten(structure, leaves)
    return [ShapedArray(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(_shapes(step, given.size))]


@partial(jax.jit, static_argnames=("step", "structure"))
def _play(*leaves: jax.Array, step: TracedStep, structure: PyTreeDef) -> list[jax.Array]:
    shared, given = jax.tree.unflatten(structure, leaves)
    programs = linked_steps(step, given.size, shared[1].topology_id.shape[0])
    if programs:
        return jax.tree.leaves(play_linked(programs, step, shared, given))
    return jax.tree.leaves(play_on_cpu(step, in_one_function, shared, given))


def _play_traced(*leaves: jax.Array, step: TracedStep, structure: PyTreeDef) -> list[jax.Array]:
    """Play, whatever JAX is set to where the program is lowered; `jax.disable_jit` takes no primitive apart."""
    with jax.enable_x64(step.dtype == "float64"), jax.disable_jit(False):
        return _play(*leaves, step=step, structure=structure)


_play_on_cpu = Primitive("play_on_cpu")
_play_on_cpu.multiple_results = True
_play_on_cpu.def_abstract_eval(_avals)
_play_on_cpu.def_impl(_play_traced)
mlir.register_lowering(_play_on_cpu, mlir.lower_fun(_play_traced, multiple_results=True))

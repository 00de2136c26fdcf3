"""One decision of the worlds of one topology on a CPU: a program compiled apart and linked into the user's program.

Nothing in it depends on how many worlds a batch has: it is compiled for tables of more rows than any, and reads and
writes those of its worlds alone. So a batch of any size takes the same machine code.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Final

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.next_game import NextGame
from iphyre_jax.envs.traced.cpu_groups import Given, play_group
from iphyre_jax.envs.traced.sorting import one_game
from iphyre_jax.envs.traced.step import Games, StepOutput, TracedStep
from iphyre_jax.execution import programs
from iphyre_jax.execution.compilation.executables import linked
from iphyre_jax.execution.devices import linked_lanes
from iphyre_jax.execution.layout import Parts
from iphyre_jax.execution.machine_code.linked import MOST_ROWS, LinkedProgram
from iphyre_jax.execution.machine_code.linking import can_link
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.physics.types import Timing

# Moving bodies of programs that compile a step twice, for few contact slots and for all. With more of them it saves 4 %
# of the time of a decision at 60 fps, and takes two and a half times as long to compile.
MOST_TWICE: Final = 2


@dataclass(frozen=True)
class TopologyStep:
    """One decision of the worlds of one topology of a batch, groups of lanes one after the other.

    Attributes:
        step: what is played.
        topology_id: which topology of its.
        lanes: worlds side by side.
        games: rows of the table of games: 1, at most `lanes`, or MOST_ROWS.
        neighbours: see `Group`.
    """

    sources: ClassVar[tuple[str, ...]] = (
        *programs.SOURCES,
        "envs/traced/cpu_groups.py",
        "envs/traced/episode_rows.py",
        "envs/traced/scene_rows.py",
        "envs/traced/step.py",
        "envs/traced/step_program.py",
        "envs/batching",
        "observations",
    )

    step: TracedStep
    topology_id: int
    lanes: int
    games: int
    neighbours: bool

    @property
    def dtype(self) -> str:
        """Of the physics."""
        return self.step.dtype

    @property
    def in_place(self) -> int:
        """How many of its last arguments receive its results: the tables of `StepOutput`."""
        return len(jax.tree.leaves(self._shapes[1]))

    def arguments(self) -> programs.Shapes:
        """Return the shapes of the leaves of what `_play` takes."""
        return tuple(jax.tree.leaves(self._shapes))

    def example(self) -> tuple[npt.NDArray[Any], ...]:
        """Return the leaves of what `_play` takes, of two groups that make no step, but begin anew: all are solved."""
        worlds = self.lanes * 2 if self.neighbours else self.lanes + 1

        def zeros(leaf: jax.Array) -> npt.NDArray[Any]:
            return np.zeros([min(leaf.shape[0], worlds), *leaf.shape[1:]] if leaf.shape else [], leaf.dtype)

        (batch, first, last), out = jax.tree.map(zeros, self._shapes)
        batch = batch._replace(game_count=last + 1, order=np.arange(worlds, dtype=np.int32))
        solved = out.now.state._replace(whole=np.ones_like(out.now.state.whole))  # `Status.success` is one of them
        out = out._replace(now=out.now._replace(state=solved))
        return tuple(jax.tree.leaves((batch, first, last + worlds, out)))

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the leaves of what `_play` returns."""
        given, out = jax.tree.unflatten(jax.tree.structure(self._shapes), arguments)
        return tuple(jax.tree.leaves(in_one_function(self._play, *given, in_place=(out,))))

    def _play(self, batch: Given, first: jax.Array, last: jax.Array, out: StepOutput) -> StepOutput:
        """Return the tables after the decision.

        Args:
            batch: what is played.
            first: () int32, the place in the order of the topology's first world.
            last: () int32, the place after its last one.
            out: the states of all worlds before the decision.
        """
        topology = self.step.topologies[self.topology_id]
        few_slots = topology.moving <= MOST_TWICE
        play = partial(play_group, self.step, topology, self.lanes, self.neighbours, few_slots)

        def play_next(number: jax.Array, out: StepOutput) -> StepOutput:
            return play(batch, last, first + number * self.lanes, out)

        return jax.lax.fori_loop(0, (last - first + self.lanes - 1) // self.lanes, play_next, out)

    @cached_property
    def _shapes(self) -> tuple[tuple[Given, jax.Array, jax.Array], StepOutput]:
        """Return the shapes of what `_play` takes."""

        def zeros() -> tuple[tuple[Given, jax.Array, jax.Array], StepOutput]:
            step, games, whole, rows = self.step, self.games, jnp.int32(0), jnp.zeros(MOST_ROWS, jnp.int32)
            request = jnp.zeros((MOST_ROWS, step.request_words), jnp.int32)
            number = jnp.zeros((), step.dtype)
            timing = Timing(number, number, number, jnp.zeros(2, step.dtype))
            scenes = Parts(*(jnp.zeros((games, words), dtype) for words, dtype in step.scene_parts))
            table = Games(jnp.zeros(games, jnp.int32), scenes, step.blank(games).now)
            next_game = NextGame(rows, jnp.zeros((MOST_ROWS, 2), jnp.uint32))
            batch = Given(timing, table, whole, rows, request, next_game, rows)
            return (batch, whole, whole), step.blank(MOST_ROWS)

        with jax.enable_x64(self.dtype == "float64"):
            return jax.eval_shape(zeros)


def linked_steps(step: TracedStep, worlds: int, games: int) -> list[LinkedProgram] | None:
    """Return the programs of the topologies, linked into this process; None if that cannot be.

    Args:
        step: what is played.
        worlds: of the batch.
        games: rows of the table of games.
    """
    if not can_link() or max(worlds, games) > MOST_ROWS:
        return None
    alone = one_game(games, len(step.topologies))
    wanted = []
    for topology_id, topology in enumerate(step.topologies):
        lanes = linked_lanes(topology)
        known = 1 if games == 1 else lanes if games <= lanes else MOST_ROWS
        # One block of rows that goes into two tables, XLA does not write in place: it would write the whole tables.
        neighbours = alone and not worlds % lanes and not step.keep_final
        wanted.append(TopologyStep(step, topology_id, lanes, known, neighbours))
    return linked(wanted)

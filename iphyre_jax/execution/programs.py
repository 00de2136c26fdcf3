"""What is compiled to play plans: functions of a few flat tables, one for each topology, type and number of lanes.

A program is a frozen dataclass of plain values, so that it can be described to the process that compiles it and name an
entry of the cache. `run` is the function, `arguments` are the shapes that it takes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import ClassVar, Final, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax import rollouts
from iphyre_jax.execution.layout import Layout
from iphyre_jax.physics.types import Timing, Topology, World

Shapes = tuple[jax.ShapeDtypeStruct, ...]
TIMING_NUMBERS: Final = 5  # numbers of a packed `Timing`
SOURCES: Final = ("physics", "rollouts.py", "execution/programs.py", "execution/layout.py")
SPARE: Final = -2  # in a plan: this lane is over before it starts


class Program(Protocol):
    """A function to compile; implementations are frozen dataclasses that `description.describe` takes.

    Attributes:
        sources: files and folders of the package that decide what is compiled, relative to it.
    """

    sources: ClassVar[tuple[str, ...]]

    def __hash__(self) -> int:
        """Two that are equal are one program."""

    @property
    def dtype(self) -> str:
        """The physics' type: "float32" or "float64"."""

    @property
    def lanes(self) -> int:
        """Worlds side by side; the length of the last axis of what has one for them."""

    def arguments(self) -> Shapes:
        """Return the shapes of the arguments of `run`."""

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Do the work; traced."""


def pack_timing(timing: Timing) -> npt.NDArray[np.floating]:
    """Return a `Timing` as one array, (CLOCK,)."""
    return np.concatenate([np.atleast_1d(np.asarray(part)) for part in jax.tree.leaves(timing)])


def unpack_timing(numbers: jax.Array) -> Timing:
    """Return the `Timing` of an array of `pack_timing`."""
    return Timing(numbers[0], numbers[1], numbers[2], numbers[3:TIMING_NUMBERS])


@lru_cache(1024)
def world_layout(topology: Topology, dtype: str) -> Layout:
    """Return the layout of the worlds of a topology."""
    return Layout.of(World.shapes(topology, dtype), dtype)


@lru_cache(1024)
def episode_layout(topology: Topology, dtype: str) -> Layout:
    """Return the layout of episodes of a topology."""
    with jax.enable_x64(dtype == "float64"):
        world, done = World.shapes(topology, dtype), jax.ShapeDtypeStruct((), "bool")
        return Layout.of(jax.eval_shape(partial(rollouts.reset_episode, topology), world, done), dtype)


def in_one_function(
    work: Callable[..., jax.Array], arguments: Sequence[jax.Array], like: jax.ShapeDtypeStruct, once: jax.Array
) -> jax.Array:
    """Return work(*arguments) in a form that becomes one function of machine code.

    A compiler makes a function of a small loop, and calls of separate kernels, which it hands to other threads, of what
    stands outside. So the work is done in a loop of one turn.

    Args:
        work: returns an array.
        arguments: arrays; tied to the loop's index, or the compiler would take what hangs on them alone out of it.
        like: shape and type of the result.
        once: () int32, 1; unknown to the compiler, or it would see through the loop.
    """

    def turn(index: jax.Array, _: jax.Array) -> jax.Array:
        tied, _ = jax.lax.optimization_barrier((tuple(arguments), index))
        return work(*tied)

    return jax.lax.fori_loop(0, once, turn, jnp.zeros(like.shape, like.dtype))


@dataclass(frozen=True)
class _OfPlans:
    """A program that plays plans.

    Attributes:
        topology: of the worlds, with the contact slots that they may use.
        dtype: of the physics.
        lanes: worlds side by side.
        plan_slots: of a plan.
    """

    sources: ClassVar[tuple[str, ...]] = SOURCES

    topology: Topology
    dtype: str
    lanes: int
    plan_slots: int

    def plays(self) -> Shapes:
        """Return the shapes of worlds (rows, lanes), plans (columns, lanes), and clock.

        A plan's entries are SPARE in a lane that is not to be played.
        """
        layout = world_layout(self.topology, self.dtype)
        return (
            jax.ShapeDtypeStruct((layout.rows, self.lanes), layout.word),
            jax.ShapeDtypeStruct((self.plan_slots, self.lanes), "int32"),
            jax.ShapeDtypeStruct((TIMING_NUMBERS,), self.dtype),
        )


class Score(_OfPlans):
    """Plays whole episodes and returns what is scored."""

    def arguments(self) -> Shapes:
        """Return the shapes of `plays`, and counts (2,): the number of steps, and 1."""
        return *self.plays(), jax.ShapeDtypeStruct((2,), "int32")

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return success, steps, eliminations and fault, (4, lanes) int32."""
        worlds, plan, numbers, steps = arguments

        def play(worlds: jax.Array, plan: jax.Array) -> jax.Array:
            world = world_layout(self.topology, self.dtype).unpack(worlds)
            start = rollouts.reset_episode(self.topology, world, plan[0] == SPARE)
            out = rollouts.run_until(self.topology, world, unpack_timing(numbers), plan, start, steps[0]).result
            return jnp.stack([out.success.astype(jnp.int32), out.steps, out.eliminations, out.fault])

        like = jax.ShapeDtypeStruct((4, plan.shape[1]), jnp.int32)
        return (in_one_function(play, (worlds, plan), like, steps[1]),)


class Advance(_OfPlans):
    """Plays episodes on from where they are, and returns all of their state."""

    def arguments(self) -> Shapes:
        """Return the shapes of `plays`, steps (3,), and episodes (rows, lanes).

        The steps are the number to play to, 1, and 1 if the episodes begin, whatever their table holds.
        """
        layout = episode_layout(self.topology, self.dtype)
        steps = jax.ShapeDtypeStruct((3,), "int32")
        return *self.plays(), steps, jax.ShapeDtypeStruct((layout.rows, self.lanes), layout.word)

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the episodes, (rows, lanes)."""
        worlds, plan, numbers, steps, episodes = arguments
        layout = episode_layout(self.topology, self.dtype)

        def play(worlds: jax.Array, plan: jax.Array, episodes: jax.Array) -> jax.Array:
            world = world_layout(self.topology, self.dtype).unpack(worlds)
            start = jax.lax.cond(
                steps[2] != 0,
                lambda: rollouts.reset_episode(self.topology, world, plan[0] == SPARE),
                lambda: layout.unpack(episodes),
            )
            return layout.pack(rollouts.run_until(self.topology, world, unpack_timing(numbers), plan, start, steps[0]))

        like = jax.ShapeDtypeStruct(episodes.shape, episodes.dtype)
        return (in_one_function(play, (worlds, plan, episodes), like, steps[1]),)

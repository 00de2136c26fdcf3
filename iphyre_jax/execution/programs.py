"""Programs that play plans: functions of a few flat tables, one for each topology, dtype and number of lanes.

A program is a frozen dataclass of plain values. So it can be described to the process that compiles it, and it names an
entry of the cache. `run` is the function to compile, `arguments` are the shapes of its arguments.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar, Final, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax import rollouts
from iphyre_jax.execution.gpu.one_kernel import in_one_kernel
from iphyre_jax.execution.layout import Layout
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.physics.types import Timing, Topology, World

Shapes = tuple[jax.ShapeDtypeStruct, ...]
TIMING_NUMBERS: Final = 5  # numbers of a packed `Timing`
SOURCES: Final = (
    "rules.py",
    "physics",
    "rollouts.py",
    "execution/programs.py",
    "execution/layout.py",
    "execution/one_function.py",
    "execution/gpu/one_kernel.py",
)
SPARE: Final = -2  # in a plan: the lane is spare, done before it starts


class Program(Protocol):
    """A function to compile; implementations are frozen dataclasses that `description.describe` takes.

    Attributes:
        sources: files and folders of the package that decide what is compiled, relative to the package.
    """

    sources: ClassVar[tuple[str, ...]]

    def __hash__(self) -> int:
        """Equal programs are one program."""

    @property
    def dtype(self) -> str:
        """Of the physics: "float32" or "float64"."""

    @property
    def lanes(self) -> int:
        """Number of worlds side by side; the length of the last axis of arrays with lanes."""

    def arguments(self) -> Shapes:
        """Return the shapes of the arguments of `run`."""

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the results; traced."""


@runtime_checkable
class InPlaceProgram(Program, Protocol):
    """A program that becomes an operation of the user's programs, see `machine_code`; the host does not call it."""

    @property
    def in_place(self) -> int:
        """How many of its last arguments receive its results, one each."""

    def example(self) -> tuple[npt.NDArray[Any], ...]:
        """Return arguments with few rows. The process that compiles the program plays them first."""


def pack_timing(timing: Timing) -> npt.NDArray[np.floating]:
    """Return a `Timing` as one array, (TIMING_NUMBERS,)."""
    return np.concatenate([np.atleast_1d(np.asarray(part)) for part in jax.tree.leaves(timing)])


def unpack_timing(numbers: jax.Array) -> Timing:
    """Return the `Timing` of an array from `pack_timing`."""
    return Timing(numbers[0], numbers[1], numbers[2], numbers[3:TIMING_NUMBERS])


@lru_cache(1024)
def world_layout(topology: Topology, dtype: str) -> Layout:
    """Return the layout of a packed world."""
    return Layout.of(World.shapes(topology, dtype), dtype)


@lru_cache(1024)
def episode_layout(topology: Topology, dtype: str) -> Layout:
    """Return the layout of a packed episode."""
    with jax.enable_x64(dtype == "float64"):
        world, done = World.shapes(topology, dtype), jax.ShapeDtypeStruct((), "bool")
        return Layout.of(jax.eval_shape(partial(rollouts.reset_episode, topology), world, done), dtype)


@dataclass(frozen=True)
class _PlanProgram(ABC):
    """A program that plays plans.

    Attributes:
        topology: of the worlds, with the contact slots that they may use.
        dtype: of the physics.
        lanes: worlds side by side.
        plan_slots: of the plans.
    """

    sources: ClassVar[tuple[str, ...]] = SOURCES

    topology: Topology
    dtype: str
    lanes: int
    plan_slots: int

    def plan_arguments(self) -> Shapes:
        """Return the shapes of worlds (words, lanes), plans (plan_slots, lanes), SPARE in spare lanes, and timing."""
        layout = world_layout(self.topology, self.dtype)
        return (
            jax.ShapeDtypeStruct((layout.rows, self.lanes), layout.word),
            jax.ShapeDtypeStruct((self.plan_slots, self.lanes), "int32"),
            jax.ShapeDtypeStruct((TIMING_NUMBERS,), self.dtype),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the result of `in_lanes`; arguments: worlds, plans, timing, steps, and what else has lanes."""

        def play(
            worlds: jax.Array, plan: jax.Array, numbers: jax.Array, steps: jax.Array, *more: jax.Array
        ) -> jax.Array:
            return in_one_kernel(self.in_lanes, (numbers, steps), (worlds, plan, *more))

        return (in_one_function(play, *arguments),)

    @abstractmethod
    def in_lanes(self, shared: tuple[jax.Array, jax.Array], lanes: tuple[jax.Array, ...]) -> jax.Array:
        """Play, and return what a program returns; shared: timing and steps."""


class Score(_PlanProgram):
    """Plays whole episodes and returns their scores."""

    def arguments(self) -> Shapes:
        """Return the shapes of `plan_arguments`, and the number of steps, (1,)."""
        return *self.plan_arguments(), jax.ShapeDtypeStruct((1,), "int32")

    def in_lanes(self, shared: tuple[jax.Array, jax.Array], lanes: tuple[jax.Array, ...]) -> jax.Array:
        """Return success, steps, eliminations and fault, (4, lanes) int32; lanes: worlds and plans."""
        (numbers, steps), (worlds, plan) = shared, lanes
        world = world_layout(self.topology, self.dtype).unpack(worlds)
        start = rollouts.reset_episode(self.topology, world, plan[0] == SPARE)
        out = rollouts.run_until(self.topology, world, unpack_timing(numbers), plan, start, steps[0]).result
        return jnp.stack([out.success.astype(jnp.int32), out.steps, out.eliminations, out.fault])


class Advance(_PlanProgram):
    """Plays episodes on and returns their whole state."""

    def arguments(self) -> Shapes:
        """Return the shapes of `plan_arguments`, steps (2,), and episodes (words, lanes).

        The steps are the number to play to, and 1 to reset the episodes first.
        """
        layout = episode_layout(self.topology, self.dtype)
        steps = jax.ShapeDtypeStruct((2,), "int32")
        return *self.plan_arguments(), steps, jax.ShapeDtypeStruct((layout.rows, self.lanes), layout.word)

    def in_lanes(self, shared: tuple[jax.Array, jax.Array], lanes: tuple[jax.Array, ...]) -> jax.Array:
        """Return the episodes, (words, lanes); lanes: worlds, plans and episodes."""
        (numbers, steps), (worlds, plan, episodes) = shared, lanes
        layout = episode_layout(self.topology, self.dtype)
        world = world_layout(self.topology, self.dtype).unpack(worlds)
        start = jax.lax.cond(
            steps[1] != 0,
            lambda: rollouts.reset_episode(self.topology, world, plan[0] == SPARE),
            lambda: layout.unpack(episodes),
        )
        return layout.pack(rollouts.run_until(self.topology, world, unpack_timing(numbers), plan, start, steps[0]))

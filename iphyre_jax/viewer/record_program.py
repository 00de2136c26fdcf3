"""The compiled program of `viewer.recording`: it plays one world and keeps every frame.

It uses the same `rollouts.episode_step` as `simulate`, but compiled for one world without lanes. A whole play takes
milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp

from iphyre_jax import rollouts
from iphyre_jax.execution import programs
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.physics.collision import contacts, shapes
from iphyre_jax.physics.types import Timing, Topology, World


class Frames(NamedTuple):
    """F frames of one world, as JAX or NumPy arrays, with n moving bodies and K contact slots."""

    pose: Any  # (F, n, 3)
    velocity: Any  # (F, n, 2)
    contact: Any  # (F, K, 2) NaN for an empty slot


_Carry = tuple[jax.Array, rollouts.EpisodeState, Frames]  # step counter, episode, frames so far


@dataclass(frozen=True)
class RecordProgram:
    """Play one world and store every frame.

    Attributes:
        topology: topology of the world.
        dtype: number type of the physics.
        columns: number of entries in a plan.
        length: largest number of steps.
    """

    sources: ClassVar[tuple[str, ...]] = (*programs.SOURCES, "viewer/record_program.py")

    topology: Topology
    dtype: str
    columns: int
    length: int

    @property
    def lanes(self) -> int:
        """One world."""
        return 1

    def arguments(self) -> programs.Shapes:
        """Return the shapes of a world (rows, 1), a plan (columns,), and a clock."""
        layout = programs.world_layout(self.topology, self.dtype)
        return (
            jax.ShapeDtypeStruct((layout.rows, 1), layout.word),
            jax.ShapeDtypeStruct((self.columns,), "int32"),
            jax.ShapeDtypeStruct((programs.TIMING_NUMBERS,), self.dtype),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return success, steps, eliminations and fault, (4,) int32, then the arrays of `Frames`."""
        return in_one_function(self._record, *arguments)

    def _record(self, words: jax.Array, plan: jax.Array, numbers: jax.Array) -> tuple[jax.Array, ...]:
        world = jax.tree.map(lambda leaf: leaf[..., 0], programs.world_layout(self.topology, self.dtype).unpack(words))
        result, frames = _record_frames(self.topology, self.length, world, programs.unpack_timing(numbers), plan)
        counts = jnp.stack([result.success.astype(jnp.int32), result.steps, result.eliminations, result.fault])
        return counts, frames.pose, frames.velocity, frames.contact


def _record_frames(
    topology: Topology, length: int, world: World, timing: Timing, plan: jax.Array
) -> tuple[rollouts.EpisodeResult, Frames]:
    """Play one world and store every frame."""
    episode = rollouts.reset_episode(topology, world, jnp.zeros((), bool))
    first = _current_frame(topology, world, episode)
    frames = jax.tree.map(lambda leaf: jnp.zeros((length + 1, *leaf.shape), leaf.dtype).at[0].set(leaf), first)
    removal = rollouts.removal_steps(world, plan)

    def unfinished(carry: _Carry) -> jax.Array:
        return (carry[0] < length) & ~carry[1].result.done

    def step_and_store(carry: _Carry) -> _Carry:
        k, episode, frames = carry
        episode = rollouts.episode_step(topology, world, timing, episode, removal == k)
        frame = _current_frame(topology, world, episode)
        return k + 1, episode, jax.tree.map(lambda rows, row: rows.at[k + 1].set(row), frames, frame)

    _, episode, frames = jax.lax.while_loop(unfinished, step_and_store, (jnp.zeros((), jnp.int32), episode, frames))
    return episode.result, frames


def _current_frame(topology: Topology, world: World, episode: rollouts.EpisodeState) -> Frames:
    """Return the current frame, without the axis of frames.

    A step first moves the bodies and then collides them. So its contacts belong to the poses after the step.
    """
    state = episode.state
    shape = shapes.world_shapes(topology, world, state)
    points, *_ = contacts.collide(topology, world, shape, state.broad, state.gjk_start)
    point = points.unpack(axis=1)
    body = jnp.clip(point.first, 0, topology.moving - 1)
    where = jnp.stack([state.position.x[body] + point.arm_first.x, state.position.y[body] + point.arm_first.y], axis=-1)
    velocity = state.motion.velocity
    return Frames(
        pose=jnp.stack([state.position.x, state.position.y, state.angle], axis=-1),
        velocity=jnp.stack([velocity.x, velocity.y], axis=-1),
        contact=jnp.where((point.id >= 0)[:, None], where, jnp.nan),
    )

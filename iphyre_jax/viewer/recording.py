"""Recordings: one play, step by step, with everything that pictures and pages show of it.

`simulate` plays batches; a recording is a single world with all its poses, velocities and contact points. It stands on
the same `rollouts.episode_step`, compiled for one world without lanes, which takes milliseconds for a whole play.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax import rollouts
from iphyre_jax.execution import programs
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.compilation.executables import executable
from iphyre_jax.physics import contacts, shapes
from iphyre_jax.physics.types import Timing, Topology, World
from iphyre_jax.plans import NEVER, TIME_LIMIT
from iphyre_jax.rules import episode_reward, whole_fps
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

Floats = npt.NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Recording:
    """One play. Frame k is the world after k steps; frame 0 is the start; F = steps + 1 frames, N objects.

    Attributes:
        scene: what was played.
        plan: for each eliminable block the step before which it was to go, -1 for never.
        fps: physics steps a second, as many as frames.
        dtype: of the physics, "float64" or "float32".
        resets: number of the reset of a reused space.
        poses: (F, N, 3) x, y (px) and angle (rad) of every object, also of removed ones.
        velocities: (F, N, 2) px/s, without the solver's bias; zero at the start and for what does not move.
        contacts: (F, K, 2) px, points at which bodies touch; NaN in unused rows.
        success: every ball fell below the picture's lower edge.
        steps: physics steps made, the solving one included.
        eliminations: blocks removed by then.
        reward: 1000 if solved, less 10 for each removed block, less 1 for each second.
        fault: 0 if sound, else a code of `iphyre_jax.rollouts`.
    """

    scene: Scene
    plan: tuple[int, ...]
    fps: int
    dtype: str
    resets: int
    poses: Floats
    velocities: Floats
    contacts: Floats
    success: bool
    steps: int
    eliminations: int
    reward: float
    fault: int

    @classmethod
    def of_poses(
        cls, scene: Scene, plan: npt.ArrayLike, poses: npt.ArrayLike, *, fps: int = 60, success: bool = False
    ) -> Recording:
        """Make a recording of poses from elsewhere: the samples of `simulate`, or another engine.

        Args:
            scene: what was played.
            plan: as for `record`.
            poses: (F, N, 3) x, y (px) and angle (rad) of every object at the start and after every step, and nothing
                beyond the end; NaN for objects that are gone.
            fps: physics steps a second.
            success: how it ended.

        Returns:
            The recording; velocities are differences of poses, contacts are unknown and left out.

        Raises:
            ValueError: one line that names the argument and what was expected.
        """
        steps, seen, rate = _whole_plan(scene, plan), np.array(poses, np.float64), whole_fps(fps)
        if seen.ndim != 3 or not len(seen) or seen.shape[1:] != (scene.n_objects, 3):
            raise ValueError(f"poses: expected shape (F, {scene.n_objects}, 3), got {seen.shape}")
        seen = np.where(np.isnan(seen), seen[:1], seen)  # only static bars go; they are where they were
        if not np.isfinite(seen).all():
            raise ValueError("poses: expected finite numbers in the first frame, and NaN only for what is gone")
        velocities = np.zeros((*seen.shape[:2], 2))
        velocities[1:] = np.diff(seen[:, :, :2], axis=0) * rate
        made = len(seen) - 1
        gone = sum(NEVER < step < made for step in steps)
        reward = episode_reward(np.array([success]), np.array([gone]), np.array([made]), rate)
        empty = np.full((len(seen), 0, 2), np.nan)
        fields = {"poses": seen, "velocities": velocities, "contacts": empty}
        return cls(
            scene,
            tuple(steps),
            rate,
            "float64",
            1,
            **fields,
            success=bool(success),
            steps=made,
            eliminations=gone,
            reward=float(reward[0]),
            fault=0,
        )

    @property
    def gone_after(self) -> npt.NDArray[np.int64]:
        """(N,) the last frame in which an object is there; the last of all for what stays."""
        last = np.full(self.scene.n_objects, self.steps, np.int64)
        for block, step in zip(self.scene.eliminable_blocks, self.plan, strict=True):
            if NEVER < step < self.steps:
                last[block] = step
        return last


class _Tape(NamedTuple):
    """Frames of one world, JAX or NumPy arrays: F frames, n moving bodies, K contact slots."""

    pose: Any  # (F, n, 3)
    velocity: Any  # (F, n, 2)
    contact: Any  # (F, K, 2) NaN for an empty slot


def record(scene: Scene, plan: npt.ArrayLike, *, fps: int = 60, dtype: str = "float64", resets: int = 1) -> Recording:
    """Play one plan and keep every frame.

    A host function, as `simulate`, with the same outcome: in float64 to the last bit.

    Args:
        scene: what to play.
        plan: (S,) integers, for each eliminable block the step before which it goes, -1 for never; missing ones stay.
        fps: physics steps a second.
        dtype: "float64" or "float32", of the physics.
        resets: number of the reset of a reused space; 1 is a fresh one.

    Raises:
        ValueError: one line that names the argument and what was expected.
    """
    rate, steps = whole_fps(fps), _whole_plan(scene, plan)
    if dtype not in ("float32", "float64"):
        raise ValueError(f'dtype: expected "float32" or "float64", got {dtype!r}')
    if isinstance(resets, bool) or not isinstance(resets, int | np.integer) or resets < 1:
        raise ValueError(f"resets: expected a whole number of at least 1, got {resets!r}")
    topology, world = cached_world(scene, int(resets), dtype)
    length = int(TIME_LIMIT * rate)
    if length > (limit := topology.max_steps):
        raise ValueError(f"fps: expected at most {limit} steps in {TIME_LIMIT:g} s for this scene, got {length}")
    padded = np.full(scene.limits.blocks, NEVER, np.int32)
    padded[: len(steps)] = steps
    words = programs.world_layout(topology, dtype).pack_many([world])
    play = executable(Record(topology, dtype, len(padded), length))
    counts, *frames = play(words, padded, programs.clock(step_timing(rate, dtype)))
    success, made, eliminations, fault = counts.tolist()
    return Recording(
        scene=scene,
        plan=tuple(steps),
        fps=rate,
        dtype=dtype,
        resets=int(resets),
        **_unfold(scene, _Tape(*frames), made + 1),
        success=bool(success),
        steps=made,
        eliminations=eliminations,
        reward=float(episode_reward(np.array([success]), np.array([eliminations]), np.array([made]), rate)[0]),
        fault=fault,
    )


def _whole_plan(scene: Scene, plan: npt.ArrayLike) -> list[int]:
    """Return the checked plan with an entry for each eliminable block."""
    entries, blocks = np.asarray(plan), len(scene.eliminable_blocks)
    if entries.ndim != 1 or (entries.size and entries.dtype.kind not in "iu") or len(entries) > blocks:
        raise ValueError(f"plan: expected at most {blocks} integers, got {entries.dtype} of shape {entries.shape}")
    if entries.size and (entries.min() < NEVER or entries.max() > np.iinfo(np.int32).max):
        raise ValueError(f"plan: expected step indices or -1, got {entries.min()} to {entries.max()}")
    return [*entries.tolist(), *[NEVER] * (blocks - len(entries))]


def _unfold(scene: Scene, tape: _Tape, frames: int) -> dict[str, Floats]:
    """Return poses and velocities of all objects in list order, and contacts, of the frames played."""
    poses = np.zeros((frames, scene.n_objects, 3))
    poses[:, : scene.n_blocks, :2] = (scene.blocks[:, 0] + scene.blocks[:, 1]) / 2
    velocities = np.zeros((frames, scene.n_objects, 2))
    moving = np.flatnonzero(scene.dynamic)
    poses[:, moving] = tape.pose[:frames]
    velocities[:, moving] = tape.velocity[:frames]
    return {"poses": poses, "velocities": velocities, "contacts": np.asarray(tape.contact[:frames], np.float64)}


@dataclass(frozen=True)
class Record:
    """Plays one world and writes down every frame.

    Attributes:
        topology: of the world.
        dtype: of the physics.
        columns: of a plan.
        length: most steps.
    """

    sources: ClassVar[tuple[str, ...]] = (*programs.SOURCES, "viewer/recording.py")

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
            jax.ShapeDtypeStruct((programs.CLOCK,), self.dtype),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return success, steps, eliminations and fault, (4,) int32, and the arrays of a `_Tape`."""
        words, plan, numbers = arguments
        world = jax.tree.map(lambda leaf: leaf[..., 0], programs.world_layout(self.topology, self.dtype).unpack(words))
        result, tape = _play(self.topology, self.length, world, programs.timing_of(numbers), plan)
        counts = jnp.stack([result.success.astype(jnp.int32), result.steps, result.eliminations, result.fault])
        return counts, tape.pose, tape.velocity, tape.contact


def _play(
    topology: Topology, length: int, world: World, timing: Timing, plan: jax.Array
) -> tuple[rollouts.EpisodeResult, _Tape]:
    """Play one world and write every frame."""
    episode = rollouts.reset_episode(topology, world, jnp.zeros((), bool))
    first = _frame(topology, world, episode)
    tape = jax.tree.map(lambda leaf: jnp.zeros((length + 1, *leaf.shape), leaf.dtype).at[0].set(leaf), first)
    # A plan has as many columns as the limits allow; bars that no column removes have column -1 and match none.
    columns = jnp.arange(plan.shape[0], dtype=jnp.int32)
    removal = jnp.max(jnp.where(world.plan_slot[None] == columns[:, None], plan[:, None], NEVER), axis=0)

    def running(carry: tuple[jax.Array, rollouts.EpisodeState, _Tape]) -> jax.Array:
        return (carry[0] < length) & ~carry[1].result.done

    def once(carry: tuple[jax.Array, rollouts.EpisodeState, _Tape]) -> tuple[jax.Array, rollouts.EpisodeState, _Tape]:
        k, episode, tape = carry
        episode = rollouts.episode_step(topology, world, timing, episode, removal == k)
        frame = _frame(topology, world, episode)
        return k + 1, episode, jax.tree.map(lambda rows, row: rows.at[k + 1].set(row), tape, frame)

    _, episode, tape = jax.lax.while_loop(running, once, (jnp.zeros((), jnp.int32), episode, tape))
    return episode.result, tape


def _frame(topology: Topology, world: World, episode: rollouts.EpisodeState) -> _Tape:
    """Return what one frame shows, without the first axis.

    A step moves the bodies first and collides them then, so its contacts are those of the poses it ends with.
    """
    state = episode.state
    shape = shapes.world_shapes(topology, world, state)
    points, *_ = contacts.collide(topology, world, shape, state.broad, state.gjk_start)
    point = points.unpack(axis=1)
    body = jnp.clip(point.first, 0, topology.moving - 1)
    where = jnp.stack([state.position.x[body] + point.arm_first.x, state.position.y[body] + point.arm_first.y], axis=-1)
    velocity = state.motion.velocity
    return _Tape(
        pose=jnp.stack([state.position.x, state.position.y, state.angle], axis=-1),
        velocity=jnp.stack([velocity.x, velocity.y], axis=-1),
        contact=jnp.where((point.id >= 0)[:, None], where, jnp.nan),
    )

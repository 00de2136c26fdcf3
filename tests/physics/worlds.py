"""Small scenes made for one law each, and one world stepped by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax import Scene, Simulation, physics, simulate
from iphyre_jax.physics import State, Topology
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.cases import further_but

GRAVITY = 100.0  # px/s^2
DTYPES = ("float64", "float32")
# Laws are tried through whole plays, compiled for each number type.
LAW_DTYPES = further_but(DTYPES, "float64")

Bar = tuple[float, float, float, float]
Pairs = Sequence[tuple[int, int]]


def make_scene(
    balls: Sequence[tuple[float, float, float]],
    static: Sequence[Bar] = (),
    moving: Sequence[Bar] = (),
    *,
    joints: Pairs = (),
    springs: Pairs = (),
    eliminable: bool = True,
    name: str = "made for a test",
) -> Scene:
    """Return a scene; objects are the static bars, all eliminable or none, then the moving ones, then the balls."""
    bars = [[[x1, y1], [x2, y2]] for x1, y1, x2, y2 in (*static, *moving)]
    eli = [eliminable] * len(static) + [False] * (len(moving) + len(balls))
    dynamic = [False] * len(static) + [True] * (len(moving) + len(balls))
    return Scene(name, bars, [list(ball) for ball in balls], eli, dynamic, tuple(joints), tuple(springs))


def watch(scene: Scene, dtype: str, *, fps: float, duration: float) -> tuple[Simulation, npt.NDArray[Any]]:
    """Play a scene without removals; return the result and the poses after every step, (steps + 1, N, 3) float64."""
    played = simulate(scene, np.zeros((1, 0), int), fps=fps, duration=duration, dtype=dtype, sample_every=1)
    assert played.samples is not None
    assert played.samples.dtype == dtype
    assert not played.fault.any()
    return played, played.samples[0].astype(np.float64)


@cache
def _step(topology: Topology, dtype: str) -> Any:
    return jax.jit(partial(physics.step, topology))


@cache
def _initial_state(topology: Topology, dtype: str) -> Any:
    return jax.jit(partial(physics.initial_state, topology))


class Bench:
    """One world without lanes, for tests that set velocities or look at them.

    `velocity`: (n, 2) px/s and `angular_velocity`: (n,) rad/s at the start, moving bars before balls.
    """

    def __init__(
        self,
        scene: Scene,
        dtype: str,
        *,
        fps: float = 60,
        velocity: npt.ArrayLike | None = None,
        angular_velocity: npt.ArrayLike | None = None,
    ) -> None:
        self.dtype = dtype
        self.topology, self.world = compile_scene(scene, dtype=dtype)
        self.timing = step_timing(fps, dtype)
        with self.context():
            self.state: State = _initial_state(self.topology, dtype)(self.world)
            motion = self.state.motion
            if velocity is not None:
                x, y = np.asarray(velocity, dtype).T
                motion = replace(motion, velocity=replace(motion.velocity, x=jnp.asarray(x), y=jnp.asarray(y)))
            if angular_velocity is not None:
                motion = replace(motion, angular_velocity=jnp.asarray(np.asarray(angular_velocity, dtype)))
            self.state = replace(self.state, motion=motion)

    def context(self) -> Any:
        """Return the context in which arrays have the bench's dtype."""
        return jax.enable_x64(self.dtype == "float64")

    def step(self, count: int = 1) -> None:
        """Make steps."""
        with self.context():
            step = _step(self.topology, self.dtype)
            for _ in range(count):
                self.state = step(self.world, self.timing, self.state)

    @property
    def position(self) -> npt.NDArray[np.float64]:
        """Centres, (n, 2) px."""
        return np.stack([self.state.position.x, self.state.position.y], -1).astype(np.float64)

    @property
    def velocity(self) -> npt.NDArray[np.float64]:
        """Velocities, (n, 2) px/s."""
        velocity = self.state.motion.velocity
        return np.stack([velocity.x, velocity.y], -1).astype(np.float64)

    @property
    def angle(self) -> npt.NDArray[np.float64]:
        """Angles, (n,) rad."""
        return np.asarray(self.state.angle, np.float64)

    @property
    def angular_velocity(self) -> npt.NDArray[np.float64]:
        """Angular velocities, (n,) rad/s."""
        return np.asarray(self.state.motion.angular_velocity, np.float64)

"""One world that is played step by step from Python, in float64."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.stretches import Stretch, play_lanes, start
from iphyre_jax.observe import object_rows, scene_features
from iphyre_jax.physics import eliminate
from iphyre_jax.physics.types import State, Timing, Topology, World
from iphyre_jax.rollouts import Progress
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.build import build, timing

DTYPE = "float64"


class SteppedWorld:
    """A scene under way.

    Args:
        scene: the scene.
        fps: physics steps a second.
        resets: number of the reset of the reused space that this is.
    """

    def __init__(self, scene: Scene, fps: float, resets: int) -> None:
        self.scene = scene
        self.features = scene_features(scene)
        self.alive = np.array(self.features.present)  # (12,) bool, objects that are there
        self._timing = timing(fps, DTYPE)
        self._topology, self._world = build(scene, resets=resets, dtype=DTYPE)
        with jax.enable_x64(True):
            self._progress = start(self._topology, self._world)

    def remove(self, block: int) -> None:
        """Take an eliminable block out, with its joints and springs."""
        self.alive[block] = False
        slot = self.scene.eliminable_blocks.index(block)
        with jax.enable_x64(True):
            state = _remove(self._topology, self._world, self._progress.state, np.int32(slot))
            self._progress = replace(self._progress, state=state)

    def play(self, steps: int) -> tuple[int, bool]:
        """Play on, to the first step after which all balls are below the picture or to the end.

        Args:
            steps: the most steps to make.

        Returns:
            Steps made, and whether the last of them solved the game.

        Raises:
            RuntimeError: the world is no longer sound; one line.
        """
        before = int(self._progress.state.step)
        with jax.enable_x64(True):
            until = np.int32(before + steps)
            self._progress = _play(self._topology, self._world, self._timing, until, self._progress)
        outcome = self._progress.outcome
        if outcome.fault:
            raise RuntimeError(f"{self.scene.name}: the world is no longer sound (fault {int(outcome.fault)})")
        return int(self._progress.state.step) - before, steps > 0 and bool(outcome.success)

    def poses(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return centres (12, 2) in px and angles (12,) in rad of all objects, removed ones where they stood."""
        position, angle = np.array(self.features.position), np.zeros(len(self.alive))
        movers = np.flatnonzero(self.scene.dynamic)
        state = self._progress.state
        position[movers, 0], position[movers, 1] = np.asarray(state.position.x), np.asarray(state.position.y)
        angle[movers] = np.asarray(state.angle)
        return position, angle

    def table(self) -> npt.NDArray[np.float64]:
        """Return the official table, (12, 9) float64, in px."""
        return np.asarray(object_rows(self.features, *self.poses(), self.alive))


@partial(jax.jit, static_argnums=0)
def _remove(topology: Topology, world: World, state: State, slot: jax.Array) -> State:
    return eliminate(topology, world, state, world.column == slot)


@partial(jax.jit, static_argnums=0)
def _play(topology: Topology, world: World, timing: Timing, until: jax.Array, progress: Progress) -> Progress:
    """Play a world on, also one that is solved already: the official class never refuses a step."""
    no, never = jnp.zeros((), bool), jnp.full(1, -1, jnp.int32)
    going = replace(progress, outcome=replace(progress.outcome, over=no, success=no))
    return play_lanes(topology, timing, world, Stretch(jnp.int32(0), never, until), going)

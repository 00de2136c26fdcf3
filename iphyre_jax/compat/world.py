"""One world that Python plays step by step, in float64."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.envs.batching.play_requests import PlayRequest, run_requests
from iphyre_jax.execution import programs
from iphyre_jax.execution.batching import cached_world
from iphyre_jax.execution.compilation.executables import executable
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.execution.programs import episode_layout, pack_timing, world_layout
from iphyre_jax.observations.official import object_rows, scene_features
from iphyre_jax.physics import eliminate
from iphyre_jax.physics.types import Topology
from iphyre_jax.rollouts import EpisodeState, reset_episode
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import step_timing

DTYPE = "float64"
NO_SLOT = -2  # a bar that no slot removes has plan_slot -1


@dataclass(frozen=True)
class OfficialStep:
    """Removes a block of one world, then plays on, even if the game is already solved.

    The official class never refuses a step.
    """

    sources: ClassVar[tuple[str, ...]] = (*programs.SOURCES, "envs/batching/play_requests.py", "compat/world.py")

    topology: Topology

    @property
    def dtype(self) -> str:
        """Of the physics."""
        return DTYPE

    @property
    def lanes(self) -> int:
        """One world."""
        return 1

    def arguments(self) -> programs.Shapes:
        """Return the shapes of a world (words, 1), packed timing, a command (3,) and an episode (rows, 1).

        The command: the slot whose block goes, NO_SLOT for none; steps to play; 1 to reset the episode first.
        """
        world, episode = world_layout(self.topology, DTYPE), episode_layout(self.topology, DTYPE)
        return (
            jax.ShapeDtypeStruct((world.rows, 1), world.word),
            jax.ShapeDtypeStruct((programs.TIMING_NUMBERS,), DTYPE),
            jax.ShapeDtypeStruct((3,), "int32"),
            jax.ShapeDtypeStruct((episode.rows, 1), episode.word),
        )

    def run(self, *arguments: jax.Array) -> tuple[jax.Array, ...]:
        """Return the episode, (rows, 1)."""
        return (in_one_function(self._play, *arguments),)

    def _play(self, words: jax.Array, numbers: jax.Array, command: jax.Array, episode: jax.Array) -> jax.Array:
        world, layout = world_layout(self.topology, DTYPE).unpack(words), episode_layout(self.topology, DTYPE)
        no = jnp.zeros(1, bool)
        before: EpisodeState = jax.lax.cond(
            command[2] != 0, lambda: reset_episode(self.topology, world, no), lambda: layout.unpack(episode)
        )
        state = eliminate(self.topology, world, before.state, world.plan_slot == command[0])
        going = EpisodeState(state, replace(before.result, done=no, success=no))
        never = jnp.full((1, 1), NO_SLOT, jnp.int32)
        request = PlayRequest(never, state.step + command[1])
        return layout.pack(run_requests(self.topology, programs.unpack_timing(numbers), world, request, going))


class SteppedWorld:
    """One world of a scene.

    Args:
        scene: the scene.
        fps: physics steps a second.
        resets: number of the reset of the reused space.
    """

    def __init__(self, scene: Scene, fps: float, resets: int) -> None:
        self.scene = scene
        self.features = scene_features(scene)
        self.alive = np.array(self.features.present)  # (12,) bool, objects that are present
        topology, world = cached_world(scene, resets, DTYPE)
        self._layout = episode_layout(topology, DTYPE)
        self._run = executable(OfficialStep(topology))
        self._world = world_layout(topology, DTYPE).pack_many([world])
        self._timing = pack_timing(step_timing(fps, DTYPE))
        self._words = np.zeros((self._layout.rows, 1), self._layout.word)
        self._call(is_reset=True)

    def _call(self, *, slot: int = NO_SLOT, steps: int = 0, is_reset: bool = False) -> None:
        """Reset the episode if asked, remove the block of a slot, and play on."""
        command = np.array([slot, steps, is_reset], np.int32)
        self._words = self._run(self._world, self._timing, command, self._words)[0]
        self._episode: EpisodeState = jax.tree.map(lambda leaf: leaf[..., 0], self._layout.unpack_numpy(self._words))

    def remove(self, block: int) -> None:
        """Remove an eliminable block with its joints and springs."""
        self.alive[block] = False
        self._call(slot=self.scene.eliminable_blocks.index(block))

    def run(self, steps: int) -> tuple[int, bool]:
        """Play on, to the first step after which all balls are below the picture, or for `steps` steps.

        Args:
            steps: the most physics steps.

        Returns:
            Steps made, and whether the last of them solved the game.

        Raises:
            RuntimeError: the world has a fault; one line.
        """
        before = int(self._episode.state.step)
        self._call(steps=steps)
        result = self._episode.result
        if result.fault:
            raise RuntimeError(f"{self.scene.name}: the world is no longer sound (fault {int(result.fault)})")
        return int(self._episode.state.step) - before, steps > 0 and bool(result.success)

    def poses(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return centres (12, 2) in px and angles (12,) in rad of all objects, removed ones where they stood."""
        position, angle = np.array(self.features.position), np.zeros(len(self.alive))
        movers = np.flatnonzero(self.scene.dynamic)
        state = self._episode.state
        position[movers, 0], position[movers, 1] = state.position.x, state.position.y
        angle[movers] = state.angle
        return position, angle

    def table(self) -> npt.NDArray[np.float64]:
        """Return the official table, (12, 9) float64, in px."""
        return np.asarray(object_rows(self.features, *self.poses(), self.alive))

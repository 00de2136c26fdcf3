"""Poses of every step inside `jax.jit`: a film of many plans at once, as an array.

python examples/poses_in_jit.py
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

import iphyre_jax
from iphyre_jax.physics import Timing, Topology, World
from iphyre_jax.rollouts import EpisodeState, episode_step, removal_steps, reset_episode
from iphyre_jax.scenes.compile import compile_scene, step_timing


@partial(jax.jit, static_argnums=(0, 4))
def poses(topology: Topology, world: World, timing: Timing, plan: jax.Array, steps: int) -> tuple[jax.Array, jax.Array]:
    """Play a plan, (blocks,) int32, and return the poses after each step, (steps, moving bodies, 3), and success."""
    removal = removal_steps(world, plan)

    def once(episode: EpisodeState, step: jax.Array) -> tuple[EpisodeState, jax.Array]:
        episode = episode_step(topology, world, timing, episode, removal == step)
        found = episode.result
        return episode, jnp.stack([found.position.x, found.position.y, found.angle], axis=-1)

    start = reset_episode(topology, world, jnp.zeros((), bool))
    end, film = jax.lax.scan(once, start, jnp.arange(steps))
    return film, end.result.success


if __name__ == "__main__":
    scene = iphyre_jax.load_scene("support")
    topology, world = compile_scene(scene, dtype="float32")
    film, success = poses(topology, world, step_timing(60, "float32"), np.array([18, 6], np.int32), 150)
    print("the ball after each half second:", film[29::30, -1, :2].round(1).tolist(), "solved:", bool(success))

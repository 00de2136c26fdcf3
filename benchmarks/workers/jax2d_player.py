"""Jax2D in a worker of its own environment: ``python -m benchmarks.workers.jax2d_player``.

Its physics differs, so only its speed is compared. The scenes of a job are padded to the most bars, balls and joints of
any, because Jax2D is meant to be used with one `jax.vmap` over all scenes.
"""

from functools import partial
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax2d.engine import PhysicsEngine
from jax2d.sim_state import SimParams, SimState

from benchmarks.workers.jax2d_scenes import bars, places, room_for, state_of
from benchmarks.workers.protocol import EpisodeResults, Job, Player, serve, with_rewards


class Jax2D(Player):
    """`PhysicsEngine.step` under `jax.vmap` in a loop until all episodes are done."""

    def versions(self) -> dict[str, str]:
        """Versions of Jax2D and JAX."""
        return {name: version(name) for name in ("jax2d", "jax", "jaxlib")}

    def load(self, job: Job) -> None:
        """Build the states and the program."""
        self.job = job
        self.room = room_for(job.scenes)
        engine = PhysicsEngine(self.room)
        starts = [state_of(scene, self.room) for scene in job.scenes]
        which = np.array(job.which)
        self.start = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)[which]), *starts)
        self.removal = jnp.asarray(self._removals())
        self.run = jax.jit(partial(_episodes, engine, SimParams(dt=1 / job.fps), job.steps))

    def _removals(self) -> np.ndarray:
        """(B, polygons) step before which each bar goes, -1 for never."""
        removal = np.full((len(self.job.plans), self.room.num_polygons), -1, np.int32)
        for row, (k, plan) in enumerate(zip(self.job.which, self.job.plans, strict=True)):
            scene = self.job.scenes[k]
            place = places(scene, self.room)
            eliminable = [place[i] for i in range(len(bars(scene))) if scene["eli"][i]]
            removal[row, eliminable] = plan[: len(eliminable)]
        return removal

    def play(self) -> None:
        """Play all plans in one call."""
        self.played = jax.device_get(self.run(self.start, self.removal))

    def results(self) -> EpisodeResults:
        """Steps, success, and the rewards computed from them."""
        steps, success = (values.tolist() for values in self.played)
        return with_rewards(self.job, steps, success)


def _episodes(
    engine: PhysicsEngine, params: SimParams, limit: int, start: SimState, removal: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Play (B,) episodes; return the steps made and the success."""
    room = engine.static_sim_params
    idle = jnp.zeros(room.num_joints + room.num_thrusters)
    step = jax.vmap(engine.step, in_axes=(0, None, None))

    def running(carry: tuple[Any, ...]) -> jax.Array:
        k, _, _, done = carry
        return (k < limit) & ~jnp.all(done)

    def once(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        k, state, steps, done = carry
        polygon = state.polygon.replace(active=state.polygon.active & (removal != k))
        state, _ = step(state.replace(polygon=polygon), params, idle)
        below = (state.circle.position[..., 1] < 0) | ~state.circle.active
        return k + 1, state, steps + ~done, done | jnp.all(below, axis=1)

    batch = removal.shape[0]
    begin = 0, start, jnp.zeros(batch, jnp.int32), jnp.zeros(batch, bool)
    _, _, steps, done = jax.lax.while_loop(running, once, begin)
    return steps, done


if __name__ == "__main__":
    serve(Jax2D())

"""A scene of your own: build it, see whether it can be solved, and give it a name that `make` takes.

python examples/custom_scene.py
"""

from __future__ import annotations

import jax
import numpy as np

import iphyre_jax


def ramp_with_a_stop() -> iphyre_jax.Scene:
    """Return a scene: a ball on a shelf, a ramp below, and a stop that holds it back."""
    builder = iphyre_jax.SceneBuilder("ramp with a stop")
    builder.block((100, 200), (200, 200), eliminable=True)  # shelf
    builder.block((60, 300), (360, 400))  # ramp
    builder.block((400, 340), (400, 440), eliminable=True)  # stop
    builder.ball((150, 170), radius=20)
    return builder.build()


def solving_share(scene: iphyre_jax.Scene, plans: int = 500) -> tuple[float, float]:
    """Play random plans; return the share that solves the scene and the best reward."""
    rng = np.random.default_rng(0)
    times = rng.uniform(0.1, 8.0, (plans, len(scene.eliminable_blocks)))
    times[rng.random(times.shape) < 0.3] = np.nan  # NaN: the block stays
    played = iphyre_jax.simulate(scene, iphyre_jax.plan_to_steps(times, fps=60, rule="simulate"), fps=60)
    return float(played.success.mean()), float(played.reward.max())


def as_environment(scene: iphyre_jax.Scene) -> tuple[int, ...]:
    """Register the scene and variations of it; return the shape of a batch of observations."""
    games = [scene, *iphyre_jax.vary(scene, 7, jitter_px=10).scenes]
    iphyre_jax.register("ramps-v1", games)
    env, params = iphyre_jax.make("in-advance/ramps-v1")
    obs, _ = jax.vmap(env.reset, in_axes=(0, None))(jax.random.split(jax.random.key(0), 16), params)
    return obs.shape


if __name__ == "__main__":
    scene = ramp_with_a_stop()
    share, best = solving_share(scene)
    print(f"{share:.0%} of random plans solve it, the best gets {best:.1f} points")
    print("observations of 16 worlds:", as_environment(scene))

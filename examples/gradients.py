"""A derivative through `physics.step`: from where must a ball start on a ramp to be at a given place after 1.5 s?

    python examples/gradients.py

What is differentiable: position, angle and velocity after any number of steps, as functions of everything in `World`
that is a length, and of the state. The solver's loops end when they have nothing more to do, so the mode is forward
(`jax.jvp`, `jax.jacfwd`); `jax.grad` refuses them.

What is not: rewards and flags. They count steps and solved games, so their derivative is zero wherever there is one.
Nor is an instant a number here: a plan is a number of steps. The motion itself jumps where a contact begins or ends at
another step, and a derivative says nothing beyond such a jump. Between jumps it is exact, as for this rolling ball.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

import iphyre_jax
from iphyre_jax.physics import initial_state, step
from iphyre_jax.scenes.compile import compile_scene, step_timing

FPS, STEPS = 60, 90


def ramp() -> iphyre_jax.Scene:
    """Return a scene with a ball on a ramp."""
    builder = iphyre_jax.SceneBuilder("ramp")
    builder.block((100, 150), (100, 200), eliminable=True)  # every scene has a block to remove
    builder.block((150, 300), (500, 400))
    builder.ball((200, 270), radius=20)
    return builder.build()


def make_end(scene: iphyre_jax.Scene) -> Callable[[jax.Array], jax.Array]:
    """Return `end(start)`: the ball's x after 1.5 s, px, if it starts at x = start, px."""
    topology, world = compile_scene(scene, dtype="float32")
    timing = step_timing(FPS, "float32")

    def end(start: jax.Array) -> jax.Array:
        moved = replace(world, start=replace(world.start, x=start[None]))
        state = initial_state(topology, moved)
        state = jax.lax.fori_loop(0, STEPS, lambda _, state: step(topology, moved, timing, state), state)
        return state.position.x[0]

    return end


def fit(end: Callable[[jax.Array], jax.Array], start: float, wanted: float, rounds: int = 4) -> list[float]:
    """Find the start by Newton's method; return the ball's distance from the wanted place before each round, px."""
    both = jax.jit(lambda start: jax.jvp(end, (start,), (jnp.ones_like(start),)))
    now, away = jnp.float32(start), []
    for _ in range(rounds):
        place, slope = both(now)
        away.append(float(place - wanted))
        now = now - (place - wanted) / slope
    return away


if __name__ == "__main__":
    away = fit(make_end(ramp()), start=200.0, wanted=300.0)
    print("px away from the wanted place:", [round(each, 3) for each in away])

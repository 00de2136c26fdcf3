"""Our solver, stepped one step at a time to show what happens inside each of them."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax import Scene
from iphyre_jax.physics import State, Timing, Topology, World, eliminate, initial_state
from iphyre_jax.physics.collision import broad_phase
from iphyre_jax.physics.step import Stages, step_with_stages
from iphyre_jax.physics.types import Motion
from iphyre_jax.physics.vector import Vec
from iphyre_jax.scenes.compile import compile_scene, static_order, step_timing
from parity.engines.reference import BodyState
from parity.engines.views import Floats, Layout, StepView, jax_view


@partial(jax.jit, static_argnums=0)
def staged_step(
    topology: Topology, world: World, timing: Timing, state: State
) -> tuple[State, Stages, tuple[jax.Array, ...]]:
    """Make one step of one world; last, for every pair of moving bodies, whether the lower index has role a."""
    after, stages = step_with_stages(topology, world, timing, state)
    return after, stages, broad_phase.order(topology, world, after.broad).low_is_a


def inject_state(layout: Layout, state: State, bodies: BodyState, last: StepView | None) -> State:
    """Put the reference's state into ours: poses, velocities, and the impulses of the last step's contacts and pins.

    Bias velocities stay ours: the reference shows only their effect. The rest of the cache and what decides the order
    hold no continuous values.

    Args:
        layout: which object each body is.
        state: ours after the last step.
        bodies: the reference's after the same step.
        last: the reference's view of that step, with its contacts in the order of our slots; None at the start.

    Returns:
        Our state with the reference's numbers.
    """
    moving = list(layout.moving)

    def vec(values: Floats) -> Vec:
        return Vec(jnp.asarray(values[moving, 0]), jnp.asarray(values[moving, 1]))

    motion = state.motion
    velocity, angular_velocity = vec(bodies.velocity), jnp.asarray(bodies.angular_velocity[moving])
    state = replace(
        state,
        position=vec(bodies.position),
        angle=jnp.asarray(bodies.angle[moving]),
        motion=Motion(velocity, angular_velocity, motion.bias_velocity, motion.bias_angular_velocity),
    )
    if last is None:
        return state
    rows, pins = len(last.pairs), len(layout.topology.pins)
    # Changed as NumPy arrays: a scatter outside jit takes longer than the step.
    normal, tangent = np.array(state.cache.normal_impulse), np.array(state.cache.tangent_impulse)
    normal[0, :rows], tangent[0, :rows] = last.impulses[:, 0], last.impulses[:, 1]
    cache = replace(state.cache, normal_impulse=jnp.asarray(normal), tangent_impulse=jnp.asarray(tangent))
    state = replace(state, cache=cache)
    if not pins:
        return state
    size = np.nan_to_num(last.constraint_impulses[:pins])  # the reference shows no sign of a pin's impulse
    return replace(state, pin_impulse=jnp.asarray(np.copysign(size, np.asarray(state.pin_impulse))))


class JaxWorld:
    """One world of ours, stepped one step at a time in float64.

    Args:
        scene: the scene.
        resets: see `iphyre_jax.simulate`.
        fps: physics steps a second.
    """

    def __init__(self, scene: Scene, resets: int, fps: int) -> None:
        self.scene = scene
        self.layout, self.world, self.timing = built(scene, resets, fps)
        self.state = initial_state(self.layout.topology, self.world)

    def eliminate(self, index: int) -> None:
        """Remove object `index`, a static bar."""
        removed = np.arange(self.layout.topology.num_static) == self.layout.statics.index(index)
        self.state = eliminate(self.layout.topology, self.world, self.state, jnp.asarray(removed))

    def step(self) -> StepView:
        """Make one step."""
        self.state, *inside = staged_step(self.layout.topology, self.world, self.timing, self.state)
        return jax_view(self.layout, self.scene, *jax.device_get((self.state, *inside)))


def built(scene: Scene, resets: int, fps: int) -> tuple[Layout, World, Timing]:
    """Build the solver's world of a scene in float64, with the meaning of its body indices, and its timing."""
    topology, world = compile_scene(scene, resets=resets, dtype="float64")
    moving = [int(i) for i in np.flatnonzero(scene.dynamic)]
    return Layout(topology, tuple(moving), static_order(scene, resets)), world, step_timing(fps, "float64")

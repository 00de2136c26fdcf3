"""The reference's rigid-body solver for one world, or for many worlds side by side in lanes."""

from iphyre_jax.physics.step import eliminate, initial_state, step
from iphyre_jax.physics.types import State, Timing, Topology, World

__all__ = ["State", "Timing", "Topology", "World", "eliminate", "initial_state", "step"]

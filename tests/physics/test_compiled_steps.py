"""A step does not depend on how it is compiled."""

from __future__ import annotations

from functools import partial

import jax
import numpy as np
import pytest

from iphyre_jax import physics
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.physics.worlds import make_scene


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.further)])
def test_compiled_steps_equal_plain_ones(dtype: str) -> None:
    """A ball pressed onto a bar, three steps without jit: in float64 bit for bit, no product is fused with a sum."""
    scene = make_scene([(300.0, 170.5, 20.0)], [(200.0, 190.0, 400.0, 210.0)])
    topology, world = compile_scene(scene, dtype=dtype)
    times = step_timing(60, dtype)
    step = partial(physics.step, topology)
    with jax.enable_x64(dtype == "float64"):
        state = plain = physics.initial_state(topology, world)
        for _ in range(3):
            state = jax.jit(step)(world, times, state)
        with jax.disable_jit():
            for _ in range(3):
                plain = step(world, times, plain)
    assert float(state.motion.angular_velocity[0]) != 0
    one, two = ([np.asarray(leaf) for leaf in jax.tree.leaves(tree)] for tree in (state, plain))
    for a, b in zip(one, two, strict=True):
        if dtype == "float64" or a.dtype.kind != "f":
            np.testing.assert_array_equal(a, b)
        else:
            np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-4)

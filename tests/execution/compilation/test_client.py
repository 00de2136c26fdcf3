"""Our own CPU client beside the settings of the user's JAX."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax

pytestmark = pytest.mark.usefixtures("quick_programs")


@pytest.mark.parametrize("level", ["disallow", "disallow_explicit"])
def test_a_guard_against_transfers_is_for_the_users_devices(level: str) -> None:
    """Whatever goes in and out of our own client is no transfer of his."""
    env, params = iphyre_jax.make("on-the-fly/hole-v1")
    keys, actions = jax.random.split(jax.random.key(0), 3), jnp.ones(3, jnp.int32)
    state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)[1]
    step = jax.jit(jax.vmap(env.step, in_axes=(0, 0, 0, None)))
    step(keys, state, actions, params)
    with jax.transfer_guard(level):
        seen, *_ = step(keys, state, actions, params)
        for dtype in ("float32", "float64"):
            played = iphyre_jax.simulate("hole", [[-1, -1]], fps=10, duration=1, dtype=dtype)
    assert np.isfinite(seen).all()
    assert len(played.reward) == 1

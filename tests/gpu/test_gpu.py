"""What a GPU plays, beside the CPU of the same process: `make test-gpu`, on a machine with one.

Float64, where a CPU has pymunk's bits. A GPU differs in the last bit of a sine or cosine, hence where bars turn.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.traced import batch
from iphyre_jax.execution import devices
from iphyre_jax.execution.gpu import one_kernel
from parity.plans import random_plans

if not os.environ.get("IPHYRE_JAX_CHECK_GPU"):
    pytest.skip("needs a GPU; `make test-gpu`", allow_module_level=True)

# JAX has announced the end of Pallas's Triton backend; see docs/reference/limits.md.
pytestmark = pytest.mark.filterwarnings("ignore:The Pallas Triton backend:DeprecationWarning")

WORLDS = 96
DECISIONS = 155  # a whole episode of 15 s, and the beginning of the next


@pytest.fixture(autouse=True)
def every_part_is_a_kernel() -> Iterator[None]:
    """No part of a program falls back to its plain form."""
    assert jax.default_backend() == "gpu"
    assert one_kernel.kernels_run()
    with jax.enable_x64(True), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def on_both(work: Callable[[], Any]) -> tuple[Any, Any]:
    """Return what a GPU and a CPU make of it, on the host; on the CPU worlds play group by group, as without a GPU."""
    with jax.default_device(jax.devices("cpu")[0]), pytest.MonkeyPatch.context() as patch:
        patch.setattr(one_kernel, "kernels_run", lambda: False)
        batch._differentiable.cache_clear()
        expected = jax.tree.map(np.asarray, work())
    batch._differentiable.cache_clear()
    devices._on_accelerators.cache_clear()
    return jax.tree.map(np.asarray, work()), expected


@pytest.mark.parametrize(("game", "exact"), [("hole", True), ("multi_ball_hole", True), ("fill", False)])
def test_plays_end_alike(game: str, exact: bool) -> None:
    scene = iphyre_jax.load_scene(game)
    plans = random_plans(scene, WORLDS, 10, seed=0)
    found, expected = on_both(
        lambda: [
            getattr(iphyre_jax.simulate(scene, plans, fps=10, dtype="float64", sample_every=50), name)
            for name in ("success", "steps", "fault", "samples")
        ]
    )
    for one, other in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(found[3], expected[3], rtol=0, atol=0 if exact else 1e-6)
    assert 0 < found[0].sum() < WORLDS


def test_a_mesh_of_all_gpus_plays_the_same() -> None:
    scenes = ["hole", "support"]
    mesh = jax.make_mesh((jax.device_count(),), ("worlds",), axis_types=(jax.sharding.AxisType.Auto,))
    which = np.arange(WORLDS) % 2
    plans = np.random.default_rng(0).integers(1, 150, (WORLDS, 6))
    plans[:, 2:] = -1
    one, other = (
        iphyre_jax.simulate_many(scenes, which, plans, fps=10, dtype="float64", mesh=given) for given in (None, mesh)
    )
    np.testing.assert_array_equal(one.steps, other.steps)
    assert (one.steps < 150).any()


@pytest.mark.parametrize("games", [["hole"], ["hole", "multi_ball_hole", "support"]], ids=len)
def test_an_environment_tells_the_same(games: list[str]) -> None:
    """In a scan of the user's, autoreset included. Observations are divided in float32; a GPU rounds otherwise."""
    iphyre_jax.register(f"gpu-{len(games)}-v1", games)
    env, params = iphyre_jax.make(f"on-the-fly/gpu-{len(games)}-v1", backend="xla", dtype="float64")
    actions = np.random.default_rng(0).integers(0, env.num_actions, (DECISIONS, WORLDS))
    actions *= np.random.default_rng(1).random(actions.shape) < 0.05

    def loop(actions: jax.Array) -> Any:
        first, state = jax.vmap(env.reset_to, in_axes=(0, None))(jnp.arange(WORLDS) % params.n_games, params)

        def turn(state: Any, given: Any) -> Any:
            obs, state, *told = jax.vmap(env.step, in_axes=(0, 0, 0, None))(given[0], state, given[1], params)
            return state, (obs, told)

        keys = jax.random.split(jax.random.key(0), actions.shape)
        return first, jax.lax.scan(turn, state, (keys, actions))[1]

    found, expected = on_both(lambda: jax.jit(partial(loop))(jnp.asarray(actions, jnp.int32)))
    for one, other in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        if one.dtype == np.float32:
            np.testing.assert_allclose(one, other, rtol=0, atol=2e-7)
        else:
            np.testing.assert_array_equal(one, other)
    terminated, truncated = found[1][1][1:3]
    assert terminated.any()
    assert truncated.any()


def test_derivatives_are_those_of_the_plain_form() -> None:
    env, params = iphyre_jax.make("on-the-fly/support-v1", backend="xla", dtype="float64", observation="motion")
    key = jax.random.key(0)

    def slopes() -> Any:
        _, state = env.reset(key, params)
        _, state, *_ = env.step(key, state, jnp.int32(1), params)
        leaves, structure = jax.tree.flatten(state)
        (at,) = [k for k, leaf in enumerate(leaves) if leaf.dtype == jnp.float64]

        def seen(numbers: jax.Array) -> jax.Array:
            changed = jax.tree.unflatten(structure, [*leaves[:at], numbers, *leaves[at + 1 :]])
            return env.step(key, changed, jnp.int32(0), params)[0]

        return jax.jvp(seen, (leaves[at],), (jnp.ones_like(leaves[at]),))[1]

    found, expected = on_both(lambda: jax.jit(partial(slopes))())
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-7)
    assert np.abs(expected).max() > 1e-3

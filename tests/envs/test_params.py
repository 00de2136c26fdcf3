"""States and parameters that fit each other, or are refused: their games, their shapes, their number types."""

from __future__ import annotations

import pickle
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs.core import BackendName
from iphyre_jax.observations.official import start_observation

BACKENDS: tuple[BackendName, ...] = ("host", "xla")
GAMES = ["support", "multi_ball_hole"]  # of two topologies


@pytest.mark.parametrize("backend", BACKENDS)
def test_tables_of_any_games_have_one_shape(backend: BackendName) -> None:
    """They can be stacked, and need no program of their own."""
    iphyre_jax.register("shapes-v1", GAMES)
    env, _ = iphyre_jax.make("on-the-fly/shapes-v1", backend=backend)
    tables = [env.params([game]) for game in GAMES]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tables)
    reset = jax.vmap(env.reset_to, in_axes=(None, 0))
    for obs, game in zip(reset(0, stacked)[0], GAMES, strict=True):
        np.testing.assert_array_equal(np.delete(obs, [108, 109]), start_observation(iphyre_jax.load_scene(game)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_numbers_that_were_cut_to_32_bits_are_refused(backend: BackendName) -> None:
    """JAX without x64 loads them so; they would be played in float32."""
    env, params = iphyre_jax.make("on-the-fly/hole-v1", dtype="float64", backend=backend)
    key = jax.random.key(0)
    with jax.enable_x64(True):
        state = env.reset(key, params)[1]
    narrow: Any = pickle.loads(pickle.dumps({"state": state, "params": params}))  # noqa: S301
    whole: Any = {"state": state, "params": params}
    for name in narrow:
        given = whole | {name: narrow[name]}
        for step in (env.step, jax.jit(env.step)):
            with jax.enable_x64(True), pytest.raises(ValueError) as caught:
                step(key, given["state"], 0, given["params"])
            assert str(caught.value) == f"{name}: expected float64, got float32; load it under jax.enable_x64(True)"


@pytest.mark.parametrize("dtype", ["float32", pytest.param("float64", marks=pytest.mark.further)])
def test_the_host_refuses_another_scene_at_the_row_of_a_state(dtype: str) -> None:
    """Hole and angle differ in topology, hole and a copy of it in numbers alone."""
    env, _ = iphyre_jax.make("on-the-fly/basic-v1", dtype=dtype, autoreset=False, backend="host")
    hole = iphyre_jax.load_scene("hole")
    copy = iphyre_jax.vary(hole, 20, jitter_px=5).scenes[0]
    with jax.enable_x64(dtype == "float64"):
        first, same = env.params(["support", hole]), env.params(["seesaw", hole])
        step = jax.jit(jax.vmap(env.step, in_axes=(None, 0, None, None)))
        keys = jax.random.split(jax.random.key(0), 5)
        state = jax.vmap(env.reset_to, in_axes=(0, None))(np.ones(5, np.int32), first)[1]
        played = step(keys[0], state, 1, first)
        for kept, again in zip(*map(jax.tree.leaves, (played, step(keys[0], state, 1, same))), strict=True):
            np.testing.assert_array_equal(kept, again)  # the rows of others may change
        for other in ("angle", copy):
            line = "state: expected one of these parameters, got another scene at row 1; reset all worlds"
            with pytest.raises((jax.errors.JaxRuntimeError, ValueError), match=f"ValueError: {line}"):
                jax.block_until_ready(step(keys[0], played[1], 1, env.params(["support", other])))


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_state_of_a_game_that_the_parameters_lack_is_refused(backend: BackendName) -> None:
    env, _ = iphyre_jax.make("on-the-fly/support-v1", backend=backend)
    key = jax.random.key(0)
    three, one = env.params(["support", "hole", "hinder"]), env.params(["support"])
    state = env.reset_to(2, three)[1]
    line = "state: expected a game of these parameters, got row 2 of 1"
    for call in (
        lambda: env.step(key, state, 0, one),
        lambda: env.info(state, one),
        lambda: env.observe(state, one),
    ):
        with pytest.raises(ValueError) as caught:
            call()
        assert str(caught.value) == line
    assert float(env.step(key, state, 0, three)[2]) < 0
    if backend == "host":  # inside a program the callback knows it
        with pytest.raises(jax.errors.JaxRuntimeError, match=f"ValueError: {line}"):
            jax.block_until_ready(jax.jit(env.step)(key, state, 0, one))

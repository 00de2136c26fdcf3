"""Many decisions in one scan against the environment's own step; in advance, `test_evaluation` has them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs import Batch, Steps, unroll, unroll_on_threads

COUNTERS = ("success", "fault", "eliminations", "time")


@pytest.fixture(scope="module")
def two() -> str:
    iphyre_jax.register("unrolled-v1", ["support", "multi_ball_hole"])
    with pytest.raises(ValueError, match="name: expected a free name"):
        iphyre_jax.register("unrolled-v1", ["support"])
    return "unrolled-v1"


def hasty(weights: jax.Array, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, Any]:
    """Choose a slot now and then."""
    action = jax.random.randint(key, (), 0, 7, jnp.int32)
    return jnp.where(jax.random.uniform(key) < weights, action, 0), {"seen": obs}


def early(weights: jax.Array, key: jax.Array, obs: jax.Array) -> tuple[jax.Array, Any]:
    """Plan anything."""
    return jax.random.uniform(key, (6,)) * weights, {"seen": obs}


def stepped(env: Any, params: Any, games: jax.Array, actions: jax.Array) -> Any:
    """Play actions (T, B, ...) by `step`; what has ended begins anew with its own game if the environment says so."""
    still = replace(env, autoreset=False)

    def one(state: Any, action: jax.Array) -> Any:
        out = jax.vmap(still.step, in_axes=(None, 0, 0, None))(jax.random.key(0), state, action, params)
        going = out[0], out[1]
        if env.autoreset:
            fresh = jax.vmap(still.reset_to, in_axes=(0, None))(games, params)
            done = out[3] | out[4]
            going = jax.tree.map(
                lambda new, old: jnp.where(done.reshape(-1, *(1,) * (old.ndim - 1)), new, old), fresh, going
            )
        return going[1], (going[0], *out[2:])

    obs, state = jax.vmap(still.reset_to, in_axes=(0, None))(games, params)
    return obs, jax.jit(lambda state: jax.lax.scan(one, state, actions)[1])(state)


def assert_same(env: Any, params: Any, batch: Batch, after: Batch, steps: Steps) -> None:
    obs, (later, reward, terminated, truncated, info) = stepped(env, params, batch.game, steps.action)
    np.testing.assert_array_equal(steps.terminated, terminated)
    np.testing.assert_array_equal(steps.truncated, truncated)
    np.testing.assert_allclose(steps.reward, reward, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(steps.extras["seen"], jnp.concatenate([obs[None], later[:-1]]), atol=1e-6)
    np.testing.assert_allclose(after.obs, later[-1], atol=1e-6)
    for name in COUNTERS:
        np.testing.assert_allclose(steps.info[name], info[name], rtol=1e-6)


@pytest.mark.slow
def test_a_mixture_on_the_fly_is_played_as_step_plays_it(two: str) -> None:
    env, params = iphyre_jax.make(f"on-the-fly/{two}")
    batch = Batch.of(env, params, np.repeat([1, 0], [5, 4]))
    np.testing.assert_array_equal(batch.game, np.repeat([1, 0], [5, 4]))
    after, steps = unroll(env, hasty, np.float32(0.2), batch, jax.random.key(3), decisions=60)
    assert_same(env, params, batch, after, steps)
    assert (steps.terminated | steps.truncated).any()
    assert steps.played.all()
    with pytest.warns(DeprecationWarning, match="use unroll"):
        again = unroll_on_threads(env, hasty, np.float32(0.2), batch, jax.random.key(3), decisions=60)[1]
    np.testing.assert_array_equal(again.reward, steps.reward)


@pytest.mark.slow
def test_whole_episodes_combined_and_the_pure_form() -> None:
    """Without autoreset, from the start, as many decisions as an episode may take are whole episodes."""
    env, params = iphyre_jax.make("combined/support-v1", autoreset=False)
    batch, key, decisions = Batch.of(env, params, np.zeros(20, int)), jax.random.key(0), env.strategy.decisions
    pure = jax.jit(lambda batch, key: unroll(env, early, np.float32(0.5), batch, key, decisions=decisions))
    after, one = pure(batch, key)
    assert_same(env, params, batch, after, one)
    ended = np.asarray(one.terminated | one.truncated)
    assert ended[-1].all()
    np.testing.assert_array_equal(one.played[1:], ~ended[:-1])  # what has ended is not played
    np.testing.assert_array_equal(np.asarray(one.reward)[~np.asarray(one.played)], 0)


def test_bad_batches_get_one_line(two: str) -> None:
    env, params = iphyre_jax.make(f"on-the-fly/{two}")
    for games in ([], [[0]], [0.5], [2], [-1], ["support"]):
        with pytest.raises(ValueError, match=r"^games: expected") as caught:
            Batch.of(env, params, games)
        assert "\n" not in str(caught.value)
    batch = Batch.of(env, params, [0])
    with pytest.raises(ValueError, match=r"^policy: expected a pair \(action, extras\), got"):
        unroll(env, lambda weights, key, obs: jnp.int32(0), (), batch, jax.random.key(0), decisions=1)
    with pytest.raises(ValueError, match=r"^weights\['act'\]: expected an array, got 'relu'$"):
        unroll(env, hasty, {"act": "relu"}, batch, jax.random.key(0), decisions=1)
    for decisions in (0, True, 1.5):
        with pytest.raises(ValueError, match=r"^decisions: expected a whole number"):
            unroll(env, hasty, (), batch, jax.random.key(0), decisions=decisions)


def test_a_batch_of_another_environment_is_refused() -> None:
    env, params = iphyre_jax.make("on-the-fly/support-v1")
    batch = jax.eval_shape(lambda: env.reset(jax.random.key(0), params))
    batch = Batch(
        params, *(jax.tree.map(lambda leaf: jnp.zeros((2, *leaf.shape), leaf.dtype), one) for one in batch[::-1])
    )
    for other in (
        iphyre_jax.make("on-the-fly/support-v1", observation="motion")[0],
        iphyre_jax.make("combined/support-v1")[0],
        iphyre_jax.make("on-the-fly/support-v1", protocol="smooth")[0],
        iphyre_jax.make("on-the-fly/seesaw-v1")[0],
    ):
        with pytest.raises(ValueError, match=r"^batch: expected one of this environment, got one of another$"):
            unroll(other, hasty, (), batch, jax.random.key(0), decisions=1)

"""Many decisions in lanes against the environment's own step, for every strategy, mixed and alone."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax
from iphyre_jax.envs import Batch, observations, records, unroll, unroll_on_threads
from iphyre_jax.envs.strategies import STRATEGIES

GAMES = np.repeat([1, 0], [5, 4])  # in any order; they lie sorted in the batch
DECISIONS = {"in-advance": 1, "on-the-fly": 60, "combined": 3}
COUNTERS = ("success", "fault", "eliminations", "time")


@pytest.fixture(scope="module")
def two() -> str:
    iphyre_jax.register("unrolled-v1", ["support", "pendulum"])
    return "unrolled-v1"


def policy(space: Any, weights: jax.Array, key: jax.Array, seen: jax.Array) -> tuple[jax.Array, Any]:
    action = space.sample(key)
    if action.dtype == jnp.int32:  # a removal now and then
        action = jnp.where(jax.random.uniform(key) < weights, action, 0)
    return action, {"seen": seen}


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_unrolled_worlds_are_those_of_step(strategy: str, two: str) -> None:
    env, params = iphyre_jax.make(f"{strategy}/{two}")
    batch = Batch.of(env, params, GAMES)
    np.testing.assert_array_equal(batch.game, np.sort(GAMES))
    acting = partial(policy, env.action_space())
    decisions = DECISIONS[strategy]
    after, steps = unroll_on_threads(env, acting, np.float32(0.2), batch, jax.random.key(3), decisions=decisions)

    still = iphyre_jax.make(f"{strategy}/{two}", autoreset=False)[0]

    def alone(state: Any, action: jax.Array) -> Any:
        out = jax.vmap(still.step, in_axes=(None, 0, 0, None))(jax.random.key(0), state, action, params)
        fresh = jax.vmap(still.reset_to, in_axes=(0, None))(state.game, params)
        done = out[3] | out[4]
        pick = lambda new, old: jnp.where(done.reshape(-1, *(1,) * (old.ndim - 1)), new, old)  # noqa: E731
        seen, state = jax.tree.map(pick, fresh, (out[0], out[1]))
        return state, (seen, *out[2:])

    seen, state = jax.vmap(env.reset_to, in_axes=(0, None))(batch.game, params)
    _, (later, reward, terminated, truncated, info) = jax.jit(partial(jax.lax.scan, alone))(state, steps.action)
    np.testing.assert_array_equal(steps.terminated, terminated)
    np.testing.assert_array_equal(steps.truncated, truncated)
    assert (steps.terminated | steps.truncated).any()
    assert steps.played.all()
    np.testing.assert_allclose(steps.reward, reward, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(steps.extras["seen"], jnp.concatenate([seen[None], later[:-1]]), atol=1e-6)
    np.testing.assert_allclose(observations(env, after), later[-1], atol=1e-6)
    for name in COUNTERS:
        np.testing.assert_allclose(steps.info[name], info[name], rtol=1e-6)


def test_a_pure_unroll_is_one_on_threads_and_episodes_end(two: str) -> None:
    """Without autoreset, from the start, as many decisions as an episode may take are whole episodes."""
    env, params = iphyre_jax.make(f"combined/{two}", autoreset=False)
    batch, acting = Batch.of(env, params, GAMES), partial(policy, env.action_space())
    decisions, key = env.strategy.decisions, jax.random.key(0)
    _, one = unroll_on_threads(env, acting, (), batch, key, decisions=decisions)
    _, other = jax.jit(lambda batch, key: unroll(env, acting, (), batch, key, decisions=decisions))(batch, key)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)
    ended = np.asarray(one.terminated | one.truncated)
    assert ended[-1].all()
    np.testing.assert_array_equal(one.played[1:], ~ended[:-1])  # what has ended is not played
    np.testing.assert_array_equal(np.asarray(one.reward)[~np.asarray(one.played)], 0)


def test_a_record_is_what_a_scan_stacks() -> None:
    def turn(carry: jax.Array, count: jax.Array) -> tuple[jax.Array, Any]:
        carry = carry + 1
        return carry, (
            carry,
            carry > 2,
            {"row": jnp.stack([carry, carry * count])},
            carry.astype(jnp.int32),
            count + carry,
        )

    start = jnp.arange(3, dtype=jnp.float32)
    end, rows = records.scan(turn, start, 4)
    expected_end, expected = jax.lax.scan(turn, start, jnp.arange(4, dtype=jnp.int32))
    np.testing.assert_array_equal(end, expected_end)
    assert jax.tree.structure(rows) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(rows), jax.tree.leaves(expected), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)


def test_bad_batches_get_one_line(two: str) -> None:
    env, params = iphyre_jax.make(f"on-the-fly/{two}")
    for games in ([], [[0]], [0.5], [2], [-1], ["support"]):
        with pytest.raises(ValueError, match=r"^games: expected") as caught:
            Batch.of(env, params, games)
        assert "\n" not in str(caught.value)
    batch = Batch.of(env, params, [0])
    for decisions in (0, True, 1.5):
        with pytest.raises(ValueError, match=r"^decisions: expected a whole number"):
            unroll(env, policy, (), batch, jax.random.key(0), decisions=decisions)

"""The adapter of brax; `make test-adapters` has brax, elsewhere these tests are skipped."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import iphyre_jax

pytest.importorskip("brax")
pytestmark = pytest.mark.filterwarnings("default")  # brax's own are not ours


@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly"])
def test_under_the_wrappers_of_brax(strategy: str) -> None:
    from brax.envs.wrappers.training import wrap

    from iphyre_jax.adapters import BraxEnv

    env = BraxEnv(f"{strategy}/support-v1")
    wrapped = wrap(env, episode_length=200)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 4))
    assert state.obs.shape == (4, env.observation_size)
    step = jax.jit(wrapped.step)
    if strategy == "in-advance":
        after = step(state, jnp.full((4, env.action_size), -1.0))
        np.testing.assert_array_equal(after.reward, -15.0)
        np.testing.assert_array_equal(after.done, 1.0)
        np.testing.assert_array_equal(after.info["terminated"], 1.0)
        np.testing.assert_array_equal(after.info["truncated"], 0.0)
    else:
        after = step(state, jax.nn.one_hot(jnp.array([0, 1, 2, 6]), 7))
        np.testing.assert_allclose(after.reward, [-0.1, -10.1, -10.1, -0.1], rtol=1e-6)
        np.testing.assert_array_equal(after.done, 0.0)
    assert jax.tree.structure(after) == jax.tree.structure(state)
    step(after, jnp.zeros((4, env.action_size)))


def test_nan_removes_nothing() -> None:
    from iphyre_jax.adapters import BraxEnv

    env = BraxEnv("on-the-fly/support-v1")
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    after = jax.jit(env.step)(state, jnp.zeros(7).at[2].set(jnp.nan))
    np.testing.assert_allclose(after.reward, -0.1, rtol=1e-6)


@pytest.mark.parametrize("episode_length", [150, 200])
def test_the_time_limit_is_a_truncation_of_brax(episode_length: int) -> None:
    """With the length of an episode; with a longer one the next decision is done."""
    from brax.envs.wrappers.training import wrap

    from iphyre_jax.adapters import BraxEnv

    wrapped = wrap(BraxEnv("on-the-fly/hole-v1"), episode_length=episode_length)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
    wait = jnp.zeros((2, 7)).at[:, 0].set(1.0)
    step = jax.jit(wrapped.step)
    told = []
    for _ in range(152):
        state = step(state, wait)
        told.append([float(state.done[0]), float(state.info["truncation"][0]), float(state.info["truncated"][0])])
    assert not np.any(told[:149])
    if episode_length == 150:
        assert told[149:] == [[1, 1, 1], [0, 0, 0], [0, 0, 0]]
    else:
        assert told[149:] == [[0, 0, 1], [1, 0, 1], [0, 0, 0]]


@pytest.mark.parametrize(("strategy", "dones"), [("on-the-fly", [0, 0, 0, 0, 1]), ("combined", [1, 1, 1, 1, 1])])
def test_a_world_with_a_fault_ends(strategy: str, dones: list[int]) -> None:
    """Eight bars in one place need more contact points than a world has, long before the time limit."""
    from brax.envs.wrappers.training import wrap

    from iphyre_jax.adapters import BraxEnv

    builder = iphyre_jax.SceneBuilder("overflow")
    for number in range(8):
        builder.block((200, 335), (400, 335), eliminable=number == 0)
    builder.ball((300, 300), radius=20)
    iphyre_jax.register("overflow-v1", [builder.build()], overwrite=True)
    env = BraxEnv(f"{strategy}/overflow-v1")
    wrapped = wrap(env, episode_length=150)
    state = jax.jit(wrapped.reset)(jax.random.split(jax.random.PRNGKey(0), 1))
    wait, step = -jnp.ones((1, env.action_size)), jax.jit(wrapped.step)
    told = []
    for _ in dones:
        state = step(state, wait)
        told.append(float(state.done[0]))
    assert told == dones


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly"])
def test_numbers_are_those_of_brax_under_x64(strategy: str, dtype: str) -> None:
    """Its wrappers carry them through a scan beside float64 numbers of their own."""
    from brax.envs.wrappers.training import EvalWrapper, wrap

    from iphyre_jax.adapters import BraxEnv

    env = BraxEnv(f"{strategy}/support-v1", dtype=dtype)
    wrapped = EvalWrapper(wrap(env, episode_length=150))
    with jax.enable_x64(True):
        state = jax.eval_shape(wrapped.reset, jax.random.split(jax.random.PRNGKey(0), 2))
        after = jax.eval_shape(wrapped.step, state, jnp.zeros((2, env.action_size)))
    kinds = [jax.tree.map(lambda leaf: leaf.dtype, one) for one in (state, after)]
    assert kinds[0] == kinds[1]
    assert after.done.dtype == after.reward.dtype == after.metrics["success"].dtype == jnp.float64


@pytest.mark.parametrize("strategy", ["in-advance", "on-the-fly"])
@pytest.mark.parametrize("shape", [(), (5,), (1, 7)])
def test_actions_of_another_shape_are_refused(strategy: str, shape: tuple[int, ...]) -> None:
    from iphyre_jax.adapters import BraxEnv

    env = BraxEnv(f"{strategy}/support-v1")
    state = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
    with pytest.raises(ValueError) as caught:
        env.step(state, jnp.zeros(shape))
    assert str(caught.value) == f"action: expected shape ({env.action_size},), got {shape}"


@pytest.mark.slow
def test_the_ppo_of_brax_learns_over_it() -> None:
    from iphyre_jax.adapters import BraxEnv, mend_brax

    mend_brax()
    from brax.training.agents.ppo import train as ppo

    rewards = []
    with jax.numpy_rank_promotion("allow"):  # brax relies on it
        ppo.train(
            environment=BraxEnv("in-advance/support-v1"),
            num_timesteps=1000,
            episode_length=150,
            num_envs=32,
            batch_size=16,
            num_minibatches=2,
            unroll_length=1,
            num_updates_per_batch=2,
            num_evals=2,
            num_eval_envs=16,
            progress_fn=lambda _, metrics: rewards.append(float(metrics["eval/episode_reward"])),
        )
    assert len(rewards) == 2
    assert np.isfinite(rewards).all()

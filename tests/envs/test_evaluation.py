"""Scores of policies whose results are known, and the five-value view."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import pytest

import iphyre_jax
from iphyre_jax import SPLITS, evaluate, make
from iphyre_jax.adapters import FiveValues
from iphyre_jax.envs.batching import unrolling
from iphyre_jax.envs.in_advance import play_plans
from iphyre_jax.scenes import load_scene, scene_to_dict


def nothing(key: jax.Array, obs: jax.Array) -> jax.Array:
    return jnp.zeros(6)


def random_times(key: jax.Array, obs: jax.Array) -> jax.Array:
    return jax.random.uniform(key, (6,))


@pytest.mark.slow
def test_scores_are_those_of_the_episodes() -> None:
    key = jax.random.key(4)
    scores = evaluate(random_times, ["hole", "support"], strategy="in-advance", episodes=16, key=key)
    keys = [jax.random.fold_in(one, 0) for one in jax.random.split(key, 32)]
    actions = np.stack([np.asarray(random_times(one, jnp.zeros(0))) for one in keys])
    played = play_plans(["hole", "support"], np.repeat([0, 1], 16), actions)
    assert scores.games == ("hole", "support")
    for name, value in (("reward", played.reward), ("seconds", played.steps / 10)):
        np.testing.assert_allclose(getattr(scores, name), value.reshape(2, 16), atol=1e-4)
    np.testing.assert_array_equal(scores.success, played.success.reshape(2, 16))
    np.testing.assert_array_equal(scores.eliminations, played.eliminations.reshape(2, 16))
    assert not scores.fault.any()
    assert scores.mean_reward == pytest.approx(played.reward.mean(), abs=1e-4)
    assert scores.success_rate == played.success.mean()
    assert scores.by_split() == {"basic": pytest.approx((scores.mean_reward, scores.success_rate))}
    assert scores.by_game()["hole"] == pytest.approx((played.reward[:16].mean(), played.success[:16].mean()))


def test_a_policy_keeps_its_users_number_types() -> None:
    """In float32 physics too: a policy with float64 weights is not narrowed."""

    def policy(key: jax.Array, obs: jax.Array) -> jax.Array:
        seen.append(jnp.ones(3, float).dtype)
        return jnp.zeros(6)

    seen: list[Any] = []
    with jax.enable_x64(True):
        evaluate(policy, ["support"], strategy="in-advance", episodes=1)
    assert set(seen) == {np.dtype("float64")}


def test_any_game_and_any_file_can_be_evaluated(tmp_path: Path) -> None:
    path = tmp_path / "mine"  # the name of a file needs no ending
    path.write_text(json.dumps(scene_to_dict(load_scene("unseen_hole"))))
    for split in ("unseen_hole", str(path), path):
        assert evaluate(nothing, split, strategy="in-advance").reward.shape == (1, 1)


def test_bad_evaluations_get_one_line() -> None:
    for options, message in (
        ({"split": "bascic"}, "split: expected all, basic"),
        ({"split": []}, "scenes: expected a sequence"),
        ({"split": ["hole", "support", "hole"]}, "split: expected scenes of different names, got 'hole' twice"),
        ({"strategy": "guess"}, "strategy: expected one of in-advance, on-the-fly, combined"),
        ({"protocol": "human"}, "protocol: expected one of"),
        ({"episodes": 0}, "episodes: expected a whole number of at least 1"),
        ({"policy": None}, "policy: expected a function"),
    ):
        with pytest.raises(ValueError, match=message) as caught:
            evaluate(**({"policy": nothing, "split": "basic", "strategy": "in-advance"} | options))
        assert "\n" not in str(caught.value)
    assert set(SPLITS) == {"basic", "noisy", "compositional", "multi_ball", "unseen_basic"}


@pytest.mark.parametrize("strategy", ["in-advance", "combined"])
def test_actions_that_are_no_numbers_are_not_scored(strategy: str) -> None:
    def broken(key: jax.Array, obs: jax.Array) -> jax.Array:
        return nothing(key, obs).at[3].set(jnp.nan)

    with pytest.raises(ValueError, match=r"^policy: expected actions from 0 to 1, got nan in decision 1 of support$"):
        evaluate(broken, "support", strategy=strategy)


def test_actions_outside_their_space_are_not_scored() -> None:
    def seconds(key: jax.Array, obs: jax.Array) -> jax.Array:
        return nothing(key, obs) + 2.0  # and not shares of 15 s

    def unknown(key: jax.Array, obs: jax.Array) -> jax.Array:
        return jnp.int32(99)

    with pytest.raises(ValueError, match=r"^policy: expected actions from 0 to 1, got 2.0 in decision 1 of support$"):
        evaluate(seconds, "support", strategy="in-advance")
    with pytest.raises(ValueError, match=r"^policy: expected actions from 0 to 6, got 99 in decision 1 of support$"):
        evaluate(unknown, "support", strategy="on-the-fly")


def test_a_policy_is_never_stale_and_is_compiled_once() -> None:
    """Its arrays change between two calls, as of an agent that trains meanwhile."""

    class Agent:
        def __init__(self) -> None:
            self.times, self.scale, self.traced = jnp.zeros(6), 1.0, 0

        def act(self, key: jax.Array, obs: jax.Array) -> jax.Array:
            self.traced += 1
            return self.scale * jnp.asarray(self.times)

    agent = Agent()
    assert not evaluate(agent.act, "support", strategy="in-advance").success.any()
    compiled = unrolling._unroll._cache_size()
    agent.times = np.array([0.1, 0.4, 0, 0, 0, 0], np.float32) / 15
    assert evaluate(agent.act, "support", strategy="in-advance").success.all()
    assert (unrolling._unroll._cache_size(), agent.traced) == (compiled, 2)
    for seconds in (0.3, 0.0):  # a new function of the same program
        times = jnp.asarray([0.1, 0.1 + seconds, 0, 0, 0, 0], jnp.float32) / 15
        solved = evaluate(lambda key, obs, times=times: 1.0 * times, "support", strategy="in-advance").success.all()
        assert (bool(solved), unrolling._unroll._cache_size()) == (seconds > 0, compiled)
    agent.scale = 0.0  # no array: another program
    assert not evaluate(agent.act, "support", strategy="in-advance").success.any()
    agent.scale = 1.0
    assert evaluate(agent.act, "support", strategy="in-advance").success.all()


def test_policies_that_call_python_are_not_taken_for_each_other() -> None:
    def of(times: list[float]) -> Callable[..., jax.Array]:
        given = np.array(times, np.float32) / 15
        shape = jax.ShapeDtypeStruct((6,), jnp.float32)
        return lambda key, obs: jax.pure_callback(lambda _: given, shape, obs, vmap_method="sequential")

    assert evaluate(of([0.1, 0.4, 0, 0, 0, 0]), "support", strategy="in-advance").success.all()
    assert not evaluate(of([0.0] * 6), "support", strategy="in-advance").success.any()


def _in_scan(act: Callable[[jax.Array], jax.Array]) -> Callable[[jax.Array], jax.Array]:
    return lambda obs: jax.lax.scan(lambda carry, _: (carry, act(carry)), obs, None, length=1)[1][0]


def _in_vmap(act: Callable[[jax.Array], jax.Array]) -> Callable[[jax.Array], jax.Array]:
    return lambda obs: jax.vmap(act)(obs[None])[0]


@pytest.mark.parametrize("within", [lambda act: act, _in_scan, _in_vmap], ids=["alone", "scan", "vmap"])
def test_a_policy_is_not_stale_if_a_jitted_function_in_it_closes_over_its_arrays(within: Callable[..., Any]) -> None:
    class Agent:
        def learn(self, times: npt.ArrayLike) -> None:
            weights, key = jnp.asarray(times, jnp.float32) / 15, jax.random.key(0)
            self.act = within(jax.jit(lambda obs: weights + 0 * obs[:6] + 0 * jax.random.uniform(key)))

    agent = Agent()

    def policy(key: jax.Array, obs: jax.Array) -> jax.Array:
        return agent.act(obs)

    for times, solved in (([0.1, 0.4, 0, 0, 0, 0], True), (np.zeros(6), False), ([0.1, 0.4, 0, 0, 0, 0], True)):
        agent.learn(times)
        assert evaluate(policy, "support", strategy="in-advance").success.all() == solved


def test_five_values_under_scan() -> None:
    env = FiveValues(*make("on-the-fly/support-v1"))
    assert env.name == "on-the-fly/support-v1"
    assert env.num_actions == 7
    assert env.action_space().n == 7
    _, state = env.reset(jax.random.key(0))

    def one(state: iphyre_jax.EnvState, action: jax.Array) -> tuple[iphyre_jax.EnvState, tuple[jax.Array, ...]]:
        obs, state, reward, done, info = env.step(jax.random.key(0), state, action)
        return state, (obs, reward, done, info["terminated"], info["truncated"])

    obs, reward, done, terminated, truncated = jax.lax.scan(one, state, jnp.array([1, 2] + [0] * 60))[1]
    assert obs.shape == (62, *env.observation_space().shape)
    np.testing.assert_array_equal(done, terminated | truncated)
    assert done.sum() >= 1
    assert reward.max() > 900


@pytest.mark.parametrize("policy", [lambda obs: obs, lambda: 0, lambda weights, key, obs: obs])
def test_a_policy_of_other_arguments_is_told_which(policy: Any) -> None:
    with pytest.raises(ValueError, match=r"^policy: expected a function of a key and an observation, got one of \("):
        evaluate(policy, ["hole"], strategy="in-advance")

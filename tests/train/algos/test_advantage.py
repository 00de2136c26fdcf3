"""Advantages against tables worked by hand."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from iphyre_jax.train.algos.advantage import advantages, gae, normalize
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import PolicyGradient


def test_gae_by_hand() -> None:
    """gamma 0.5, lambda 0.5. Episode 0 has three decisions; episode 1 ends with the second.

    Episode 0: values 1 2 4, rewards 1 0 8, done at the third.
      delta = 1 + 0.5 * 2 - 1 = 1;  0 + 0.5 * 4 - 2 = 0;  8 - 4 = 4
      advantage: third 4; second 0 + 0.25 * 4 = 1; first 1 + 0.25 * 1 = 1.25
    Episode 1: values 2 0, rewards 1 3, done at the second; the third row is not there.
      delta = 1 + 0 - 2 = -1;  3 - 0 = 3;  advantage: second 3; first -1 + 0.25 * 3 = -0.25
    """
    reward = jnp.array([[1.0, 1.0], [0.0, 3.0], [8.0, 0.0]])
    value = jnp.array([[1.0, 2.0], [2.0, 0.0], [4.0, 9.0]])
    done = jnp.array([[False, False], [False, True], [True, False]])
    found = gae(reward, value, done, jnp.zeros(2), 0.5, 0.5)
    np.testing.assert_allclose(found[:, 0], [1.25, 1.0, 4.0])
    np.testing.assert_allclose(found[:2, 1], [-0.25, 3.0])


def test_an_episode_that_goes_on_is_bootstrapped() -> None:
    """One decision, not over: 1 + 0.5 * 6 - 2 = 2."""
    found = gae(jnp.ones((1, 1)), jnp.full((1, 1), 2.0), jnp.zeros((1, 1), bool), jnp.array([6.0]), 0.5, 0.9)
    np.testing.assert_allclose(found, [[2.0]])


def test_normalised_within_scenes_by_hand() -> None:
    """Scene 1: mean 500, deviation 500. Scene 2: all alike. Scene 3: mean 2, deviation 1."""
    reward = jnp.array([[1000.0, 0.0, -15.0, -15.0, 1.0, 3.0]])
    active = jnp.ones_like(reward, bool)
    expected = [[500 / 530, -500 / 530, 0, 0, -1 / 31, 1 / 31]]
    np.testing.assert_allclose(normalize(reward, active, 3, "scene", 30.0), expected, rtol=1e-6)
    np.testing.assert_array_equal(normalize(reward, active, 3, "none", 30.0), reward)
    values = np.array(reward)
    batch = (values - values.mean()) / (values.std() + 30)
    np.testing.assert_allclose(normalize(reward, active, 3, "batch", 30.0), batch, rtol=1e-5)


def test_what_was_not_there_does_not_count() -> None:
    """Two decisions of two episodes; the second of the second was not there: mean of 1, 2 and 6 is 3."""
    advantage, active = jnp.array([[1.0, 2.0], [6.0, 100.0]]), jnp.array([[True, True], [True, False]])
    found = normalize(advantage, active, 1, "scene", 0.0)
    std = np.std([1.0, 2.0, 6.0])
    np.testing.assert_allclose(found[0], [-2 / std, -1 / std], rtol=1e-5)
    np.testing.assert_allclose(found[1, 0], 3 / std, rtol=1e-5)


def trajectory(reward: list[float], done_at: int) -> Trajectory:
    """One episode with values 0; observations count the decisions; what comes after its end is not there."""
    length = len(reward)
    done, active = np.zeros((length, 1), bool), np.zeros((length, 1), bool)
    done[done_at], active[: done_at + 1] = True, True
    zeros = jnp.zeros((length, 1))
    obs = jnp.arange(length + 1, dtype=jnp.float32).reshape(-1, 1, 1)
    paid = jnp.array(reward, jnp.float32)[:, None]
    return Trajectory(obs, zeros, zeros, zeros, paid, jnp.asarray(done), jnp.asarray(active))


def test_advantages_are_in_thousands_of_points() -> None:
    settings = PolicyGradient(normalize_advantage="none", gae_lambda=1.0)
    found, target = advantages(settings, trajectory([-10.0, 0.0, 1000.0], 2), 1)
    np.testing.assert_allclose(found[:, 0], [0.99, 1.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(target, found)

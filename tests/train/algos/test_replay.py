"""Replay: n-step transitions and the ring that keeps them, against tables worked by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.train.algos import replay
from iphyre_jax.train.algos.replay import Buffer, transitions
from iphyre_jax.train.collect import Trajectory
from iphyre_jax.train.settings.agents import DQN, OffPolicy
from iphyre_jax.train.settings.run import TrainConfig
from tests.train.algos.test_advantage import trajectory


def test_transitions_of_two_decisions_by_hand() -> None:
    """gamma 0.5, n = 2, rewards 1 2 4 in thousands, the third decision is the last, a fourth is not there.

    From 0: 1 + 0.5 * 2 = 2, then 0.25 of what is seen at 2. From 1: 2 + 0.5 * 4 = 4, nothing follows.
    From 2: 4, nothing follows.
    """
    settings = OffPolicy(gamma=0.5, n_step=2)
    found = transitions(settings, trajectory([1000.0, 2000.0, 4000.0, 0.0], 2))
    np.testing.assert_allclose(found.reward[:3], [2.0, 4.0, 4.0])
    np.testing.assert_allclose(found.discount[:3], [0.25, 0.0, 0.0])
    np.testing.assert_allclose(found.next_obs[:, 0], [2.0, 3.0, 4.0, 4.0])


def test_one_step_transitions_are_the_plain_ones() -> None:
    found = transitions(OffPolicy(gamma=0.9), trajectory([100.0, 200.0], 1))
    np.testing.assert_allclose(found.reward, [0.1, 0.2])
    np.testing.assert_allclose(found.discount, [0.9, 0.0])
    np.testing.assert_allclose(found.next_obs[:, 0], [1.0, 2.0])


CONFIG = TrainConfig(
    agent="dqn", strategy="on-the-fly", head="uniform", games=("hole",), episodes_per_scene=1, learner=DQN()
)


def episode(name: float, decisions: int) -> Trajectory:
    """One episode of so many decisions, padded to the most that there can be; observations are all `name`."""
    length = CONFIG.decisions_per_update
    found = trajectory([0.0] * length, decisions - 1)
    return found._replace(obs=jnp.full_like(found.obs, name))


def after(settings: OffPolicy, *episodes: Trajectory) -> Buffer:
    """A ring to which these were added, one after the other."""
    obs, raw_action = jnp.zeros((1, 1)), jnp.zeros((1,))
    buffer = replay.empty(CONFIG, settings, obs, raw_action)
    for k, one in enumerate(episodes):
        buffer = replay.add(CONFIG, settings, buffer, one, jax.random.key(k))
    return buffer


def test_only_decisions_that_were_made_are_kept_and_the_oldest_go_first() -> None:
    """Two, two and three decisions in a ring of five: the third episode's last ones take the place of the first's."""
    settings = DQN(buffer_size=5, samples_per_update=5)
    some = after(settings, episode(1.0, 2), episode(2.0, 2))
    np.testing.assert_array_equal(some.transitions.obs[:, 0], [1, 1, 2, 2, 0])
    assert (int(some.position), int(some.size)) == (4, 4)
    full = after(settings, episode(1.0, 2), episode(2.0, 2), episode(3.0, 3))
    np.testing.assert_array_equal(full.transitions.obs[:, 0], [3, 3, 2, 2, 3])
    assert (int(full.position), int(full.size)) == (2, 5)


@pytest.mark.parametrize("key", range(3))
def test_of_too_many_decisions_a_random_part_is_kept(key: int) -> None:
    """Three of an episode's nine, none twice; the rows of the ring stay five."""
    settings = DQN(buffer_size=5, samples_per_update=3)
    one = episode(0.0, 9)
    one = one._replace(obs=jnp.arange(len(one.obs), dtype=jnp.float32).reshape(-1, 1, 1))
    buffer = after(settings)
    found = replay.add(CONFIG, settings, buffer, one, jax.random.key(key))
    kept = np.asarray(found.transitions.obs[:3, 0])
    assert len(set(kept)) == 3
    assert kept.max() < 9
    np.testing.assert_array_equal(found.transitions.obs[3:, 0], 0.0)
    assert int(found.size) == 3


def test_a_buffer_has_one_number_type_whatever_the_flag() -> None:
    obs, action = jnp.zeros((1, 1), jnp.float32), jnp.zeros((1,), jnp.float32)
    with jax.enable_x64(True):
        buffer = replay.empty(CONFIG, OffPolicy(), obs, action)
    assert {leaf.dtype.name for leaf in buffer.transitions} == {"float32"}


def test_a_buffer_holds_at_least_an_update() -> None:
    assert OffPolicy(buffer_size=10).capacity(150) == 150
    assert OffPolicy(buffer_size=10, samples_per_update=4).capacity(150) == 10
    assert OffPolicy(buffer_size=1000).capacity(150) == 1000

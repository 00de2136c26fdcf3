"""On the fly, greedily: removals at the median of their time, against hand-worked numbers."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from iphyre_jax.train.hazard import median_action, no_hazard


def played(decisions: list[list[float]]) -> list[int]:
    """The actions of one episode, given the chances of no-op and the six slots at each decision."""
    hazard, actions = no_hazard(jnp.ones((1, 6), bool)), []
    for chances in decisions:
        with np.errstate(divide="ignore"):
            logs = np.log(np.array([chances + [0.0] * (7 - len(chances))], np.float32))
        action, hazard = median_action(hazard, jnp.asarray(logs))
        actions.append(int(action[0]))
    return actions


def test_a_small_chance_acts_at_its_median_and_again() -> None:
    """0.9^6 = 0.53, 0.9^7 = 0.478: the seventh decision acts; of 0.02 that is left, 0.98^35 = 0.493."""
    actions = played([[0.9, 0.02, 0.08]] * 50)
    assert [index for index, action in enumerate(actions) if action] == [6, 41]
    assert (actions[6], actions[41]) == (2, 1)


def test_the_likeliest_block_at_that_moment_goes() -> None:
    """0.4 of block 1 first; then 0.6 x 0.3 of block 2, which leaves 0.42."""
    assert played([[0.6, 0.4], [0.7, 0.0001, 0.2999]]) == [0, 2]


def test_choosing_a_block_that_has_gone_is_doing_nothing() -> None:
    """A policy that still prefers block 2, with 0.3 of block 1: 0.7 is left, then 0.49."""
    assert played([[0.0, 0.3, 0.7]] * 3 + [[0.0, 0.0, 1.0]] * 5) == [2, 0, 1, 0, 0, 0, 0, 0]


def test_choosing_a_slot_without_a_block_is_doing_nothing() -> None:
    """Slot 3 is empty: of block 1, 0.7 is left, then 0.49."""
    hazard, actions = no_hazard(jnp.array([[True, True, False, False, False, False]])), []
    chances = jnp.array([[0.0, 0.3, 0.0, 0.7, 0.0, 0.0, 0.0]])
    for _ in range(2):
        action, hazard = median_action(hazard, jnp.log(chances))
        actions.append(int(action[0]))
    assert actions == [0, 1]


def test_a_sure_policy_acts_at_once_and_one_that_never_acts_does_not() -> None:
    assert played([[0.01, 0.0, 0.99], [1.0], [0.02, 0.98]]) == [2, 0, 1]
    assert played([[1.0]] * 150) == [0] * 150


def test_episodes_do_not_mix() -> None:
    hazard = no_hazard(jnp.ones((2, 6), bool))
    chances = np.array([[0.8, 0.2, 0, 0, 0, 0, 0], [0.5, 0, 0.5, 0, 0, 0, 0]])
    with np.errstate(divide="ignore"):
        action, hazard = median_action(hazard, jnp.asarray(np.log(chances), jnp.float32))
    np.testing.assert_array_equal(action, [0, 2])
    np.testing.assert_allclose(hazard.survival, [0.8, 1.0], rtol=1e-6)
    np.testing.assert_array_equal(np.argwhere(hazard.gone), [[1, 1]])

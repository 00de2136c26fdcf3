import re

import numpy as np
import pytest

from iphyre_jax.attempts.policy_tries import JUDGED, PolicyTries, differs
from iphyre_jax.attempts.protocol import Attempt, attempts
from iphyre_jax.scenes import Scene, load_scene
from iphyre_jax.train.storage.pretrained import load_pretrained

SCENE = load_scene("support")
NEVER = np.nan


def test_plans_differ_in_a_block_or_clearly_in_time() -> None:
    plan = np.array([2.0, NEVER])
    others = np.array([[2.0, NEVER], [2.15, NEVER], [2.3, NEVER], [2.0, 1.0], [NEVER, NEVER]])
    assert differs(others, plan).tolist() == [False, False, True, True, True]
    assert differs(np.array([[10.9, NEVER], [11.5, NEVER]]), np.array([10.0, NEVER])).tolist() == [False, True]


@pytest.mark.slow
def test_the_greedy_plan_first_then_others_that_differ() -> None:
    policy = load_pretrained("ppo-i")
    agent = PolicyTries(policy.config, policy.state)
    plans = agent(SCENE, 4, np.random.default_rng(0), ())
    assert all(differs(plans[:index], plans[index]).all() for index in range(1, 4))
    past = [Attempt(plan, False, -20.0, 1, 15.0, None) for plan in plans]
    assert differs(plans, agent(SCENE, 1, np.random.default_rng(1), past)[0]).all()
    assert not np.array_equal(plans[1:], agent(SCENE, 4, np.random.default_rng(2), ())[1:])


def test_the_first_try_is_the_greedy_episode() -> None:
    policy = load_pretrained("ppo-i")
    games = ["support", "hole"]
    config = policy.config
    found = attempts(
        PolicyTries(config, policy.state), 1, games=games, fps=config.fps, resets=config.resets, dtype=config.dtype
    )
    shipped = {game["game"]: game["greedy"]["reward"] for game in policy.scores["games"]}
    assert found.reward[:, 0, 0] == pytest.approx([shipped[game] for game in games])


def test_other_heads_and_temperatures_are_refused() -> None:
    policy = load_pretrained("ppo-i")
    with pytest.raises(ValueError, match=r"^temperature: expected a positive number"):
        PolicyTries(policy.config, policy.state, 0.0)
    other = load_pretrained("ppo-o")
    with pytest.raises(ValueError, match=re.escape("config: expected a policy in advance with the head time_grid")):
        PolicyTries(other.config, other.state)


def test_a_judge_orders_the_tries_and_sees_the_times_of_the_steps() -> None:
    policy = load_pretrained("ppo-i")
    seen: list[np.ndarray] = []

    def judge(scene: Scene, plans: np.ndarray) -> np.ndarray:
        assert scene is SCENE
        seen.append(plans)
        return 1e-6 + (1 - 2e-6) * np.nan_to_num(plans[:, 0], nan=0.0) / 15  # the later the first block, the better

    agent = PolicyTries(policy.config, policy.state, 3.0, judge, greedy_bonus=0.0)
    plans = agent(SCENE, 3, np.random.default_rng(0), ())
    assert len(seen) == 1
    assert len(seen[0]) == JUDGED + 1
    tenths = 10 * seen[0][~np.isnan(seen[0])]
    np.testing.assert_allclose(tenths, np.round(tenths), atol=1e-9)
    assert all(differs(plans[:index], plans[index]).all() for index in range(1, 3))
    greedy = PolicyTries(policy.config, policy.state)(SCENE, 1, np.random.default_rng(0), ())[0]
    assert plans[0, 0] > greedy[0]
    past = [Attempt(plan, False, -20.0, 1, 15.0, None) for plan in plans]
    assert differs(plans, agent(SCENE, 1, np.random.default_rng(0), past)[0]).all()
    sure = PolicyTries(policy.config, policy.state, 3.0, lambda _, plans: np.full(len(plans), 0.5))
    np.testing.assert_array_equal(sure(SCENE, 1, np.random.default_rng(0), ())[0], greedy)  # the likeliest plan
    heavy = PolicyTries(policy.config, policy.state, 3.0, judge, policy_weight=1e6)
    np.testing.assert_array_equal(heavy(SCENE, 1, np.random.default_rng(0), ())[0], greedy)
    bold = PolicyTries(policy.config, policy.state, 3.0, judge, greedy_bonus=1e6)
    np.testing.assert_array_equal(bold(SCENE, 1, np.random.default_rng(0), ())[0], greedy)
    with pytest.raises(ValueError, match=r"^greedy_bonus: expected a finite number of at least 0, got -1"):
        PolicyTries(policy.config, policy.state, greedy_bonus=-1.0)
    with pytest.raises(ValueError, match=r"^policy_weight: expected a finite number of at least 0, got -1"):
        PolicyTries(policy.config, policy.state, policy_weight=-1.0)

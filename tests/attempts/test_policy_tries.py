import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from iphyre_jax.attempts.policy_tries import JUDGED, PolicyTries, _untried, differs
from iphyre_jax.attempts.protocol import Attempt, attempts
from iphyre_jax.models.outcome.agent import judge_of
from iphyre_jax.models.outcome.storage import load_classifier
from iphyre_jax.models.world.imagine import WorldImagination
from iphyre_jax.models.world.storage import named_model
from iphyre_jax.scenes import Limits, Scene, SceneBuilder, load_scene
from iphyre_jax.train.algos.registry import init
from iphyre_jax.train.settings.run import preset
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
    random = preset("random", "in-advance")
    with pytest.raises(ValueError, match=r"^config: expected ppo or a2c, got 'random'$"):
        PolicyTries(random, init(random, jax.random.key(0)))


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


def test_when_no_plan_is_clearly_another_one_is_tried_that_is_no_repeat() -> None:
    plans = np.array([[2.0, NEVER], [2.1, NEVER], [2.1, NEVER]])
    assert _untried(plans, []) == 0
    assert _untried(plans, [plans[0]]) == 1
    assert _untried(plans, [plans[0], plans[1]]) == 0
    assert _untried(plans, [plans[0], np.array([NEVER, 1.0]), plans[2] + 0.05]) == 1
    policy = load_pretrained("ppo-i-objects")
    tries = PolicyTries(policy.config, policy.state, judge=lambda _, plans: np.full(len(plans), 0.5))
    found = np.nan_to_num(tries(SCENE, 100, np.random.default_rng(0), ()), nan=-1.0)
    assert len(np.unique(found, axis=0)) == 100


def test_a_scene_with_larger_limits_is_tried_as_with_the_official_ones() -> None:
    policy = load_pretrained("ppo-i")
    agent = PolicyTries(policy.config, policy.state, judge=judge_of(load_classifier("relations")))
    plans = [agent(scene, 2, np.random.default_rng(0), ()) for scene in (SCENE, replace(SCENE, limits=Limits(16, 8)))]
    np.testing.assert_array_equal(*plans)
    crowded = SceneBuilder("crowded", Limits(16, 8))
    for row in range(12):
        crowded.block((100, 40 * row + 40), (200, 40 * row + 40), eliminable=row == 0)
    crowded.ball((300, 100))
    with pytest.raises(ValueError, match=r"^[^\n]*expected at most 12[^\n]*$"):
        agent(crowded.build(), 1, np.random.default_rng(0), ())


def test_judges_and_world_models_take_plans_of_the_scenes_blocks_alone() -> None:
    judge, imagine = judge_of(load_classifier("relations")), WorldImagination(named_model("objects-unlimited"))
    for shape in ((1, 3), (1, 7), (4,)):
        with pytest.raises(ValueError, match=r"^plans: expected shape \(N, 4\), a column for each block, got \("):
            judge("hole", np.zeros(shape))
        with pytest.raises(ValueError, match=r"^plans: expected shape \(N, 4\), a column for each block, got \("):
            imagine("hole", np.zeros(shape))

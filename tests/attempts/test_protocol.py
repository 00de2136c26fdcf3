import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from iphyre_jax import load_scene, simulate
from iphyre_jax.attempts.agents import do_nothing, draw_randomly, improve_best, random_plans, unrepeated
from iphyre_jax.attempts.planner import Planner, displaced
from iphyre_jax.attempts.protocol import Attempt, attempts
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.scenes import Scene

GAME = "support"


def test_results_are_those_of_simulate() -> None:
    plans = np.array([[0.7, 1.3], [np.nan, np.nan], [3.0, 2.0]])
    found = attempts(lambda scene, k, rng, past: plans, 3, games=[GAME])
    played = simulate(GAME, plan_to_steps(plans, 60, "simulate"), dtype="float64")
    assert found.success.tolist() == [[played.success.tolist()]]
    assert found.reward.tolist() == [[played.reward.tolist()]]
    assert found.seconds.tolist() == [[(played.steps / 60).tolist()]]
    assert found.success[0, 0].tolist() == [True, False, True]


def test_blind_agents_are_asked_once_and_others_see_what_happened() -> None:
    asked: list[Any] = []

    def agent(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> np.ndarray:
        asked.append((k, [(attempt.success, attempt.poses is not None) for attempt in past]))
        return np.full((k, 2), np.nan if len(past) < 1 else 0.5)

    attempts(agent, 2, games=[GAME])
    attempts(agent, 2, games=[GAME], feedback="outcome")
    assert asked == [(2, []), (1, []), (1, [(False, False)])]


def test_trajectories_are_every_tenth_of_a_second() -> None:
    seen: list[Attempt] = []

    def agent(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> np.ndarray:
        seen.extend(past)
        return np.full((k, 2), np.nan)

    attempts(agent, 2, games=[GAME], feedback="trajectory")
    assert seen[0].poses is not None
    assert seen[0].poses.shape == (151, load_scene(GAME).n_objects, 3)
    assert seen[0].poses[0, -1, :2].tolist() == load_scene(GAME).balls[0, :2].tolist()


def test_random_numbers_belong_to_game_run_and_seed() -> None:
    drawn: dict[str, list[Any]] = {}

    def agent(scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> np.ndarray:
        drawn.setdefault(scene.name, []).append(tuple(rng.random(3)))
        return np.full((k, len(scene.eliminable_blocks)), np.nan)

    attempts(agent, 1, games=[GAME], runs=2)
    attempts(agent, 1, games=[GAME], runs=1, seed=1)
    attempts(agent, 1, games=["noisy_support", GAME])
    first, second, other_seed, again = drawn[GAME]
    assert again == first
    assert len({first, second, other_seed, *drawn["noisy_support"]}) == 4


def test_doing_nothing_and_wrong_shapes() -> None:
    found = attempts(do_nothing, 2, games=[GAME])
    assert not found.success.any()
    assert found.reward.tolist() == [[[-15.0, -15.0]]]
    with pytest.raises(ValueError, match=r"^agent: expected plans of shape \(2, 2\) for support, got \(2, 3\)$"):
        attempts(lambda scene, k, rng, past: np.zeros((2, 3)), 2, games=[GAME])


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("first the left one", "plans of shape (1, 2) for support, got 'first the left one'"),
        ([["soon", 1.0]], "plans of shape (1, 2) for support, got a list of 1"),
        ([[-1.0, 2.0]], "times from 0 on, or NaN, for support, got others"),
        ([[np.inf, 2.0]], "times from 0 on, or NaN, for support, got others"),
    ],
)
def test_an_agent_that_answers_something_else_is_named(answer: Any, message: str) -> None:
    with pytest.raises(ValueError, match=rf"^agent: expected {re.escape(message)}$"):
        attempts(lambda *_: answer, 1, games=[GAME])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"k": 0}, "k: expected a whole number of at least 1 and at most 10000, got 0"),
        ({"runs": 0}, "runs: expected a whole number of at least 1, got 0"),
        ({"feedback": "pictures"}, "feedback: expected one of outcome, trajectory, got 'pictures'"),
        ({"feedback": "trajectory", "fps": 24}, "fps: expected a multiple of 10 for trajectories, got 24"),
    ],
)
def test_wrong_arguments(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as raised:
        attempts(do_nothing, games=[GAME], **arguments)
    assert str(raised.value) == message


def test_random_plans_have_the_official_distribution() -> None:
    plans = random_plans(np.random.default_rng(0), 3, 20_000)
    # 1/70 for the instant 0, and a fifth of the rest
    assert np.isnan(plans).mean() == pytest.approx(1 / 70 + 69 / 70 * 0.2, abs=0.01)
    assert set(np.rint(plans[~np.isnan(plans)] * 10)) == set(range(1, 70))
    ordered = np.sort(plans, axis=1)
    assert not (np.diff(ordered, axis=1) == 0).any()  # different instants


def test_planner_without_displacement_plays_a_plan_that_solves() -> None:
    found = attempts(Planner(plans=40), 2, games=[GAME], runs=2)
    assert found.success.all()
    assert (found.reward[..., 0] >= found.reward[..., 1] - 1e-3).all()


def test_a_planner_tries_no_plan_twice_while_there_are_others() -> None:
    """Of 30 plans of this scene's two blocks three repeat others."""
    scene, rng = load_scene("impulse_pendulum"), np.random.default_rng(0)
    drawn = random_plans(np.random.default_rng(0), len(scene.eliminable_blocks), 30)
    assert unrepeated(np.array([[1.0, np.nan], [np.nan, 1.0], [1.0, np.nan], [2.0, 1.0]])).tolist() == [1, 1, 0, 1]
    assert unrepeated(drawn).sum() == 27
    plans = Planner(plans=30)(scene, 20, rng, [])
    assert unrepeated(plans).all()
    few = Planner(plans=30)(scene, 30, np.random.default_rng(0), [])
    np.testing.assert_array_equal(few[:20], plans)
    assert unrepeated(few).sum() == unrepeated(drawn).sum()  # then the best come again
    past = [Attempt(plan, False, -35.0, 2, 15.0, None) for plan in plans]
    later = Planner(plans=30)(scene, 3, np.random.default_rng(0), past)
    np.testing.assert_array_equal(later, few[20:23])
    all_tried = [Attempt(plan, False, -35.0, 2, 15.0, None) for plan in drawn]
    np.testing.assert_array_equal(Planner(plans=30)(scene, 20, np.random.default_rng(0), all_tried), plans)


def test_planner_needs_as_many_plans_as_attempts() -> None:
    with pytest.raises(ValueError, match=r"^plans: expected at least 5 imagined plans for as many attempts, got 3$"):
        attempts(Planner(plans=3), 5, games=[GAME])


def test_displaced_scenes_keep_all_but_places() -> None:
    scene = load_scene("angle")
    copies = displaced(scene, 300, 5.0, np.random.default_rng(0))
    moved = np.array([copy.blocks - scene.blocks for copy in copies])
    assert moved[:, :, 0] == pytest.approx(moved[:, :, 1])  # no block turns
    assert moved.std() == pytest.approx(5.0, rel=0.1)
    assert {copy.joints for copy in copies} == {scene.joints}
    assert all((copy.eliminable == scene.eliminable).all() for copy in copies)


def test_improving_agent_draws_randomly_until_something_tells_its_attempts_apart() -> None:
    scene, seeds = load_scene(GAME), (np.random.default_rng(3) for _ in range(3))
    failed = Attempt(np.array([1.0, 2.0]), False, -35.0, 2, 15.0, None)
    solved = failed._replace(success=True, reward=970.0)
    first = draw_randomly(scene, 200, next(seeds), [])
    assert np.array_equal(improve_best(scene, 200, next(seeds), [failed]), first, equal_nan=True)
    near = improve_best(scene, 200, next(seeds), [failed, solved])
    assert 0.03 < (near == solved.times).all(axis=1).mean() < 0.15  # half x (half x 0.8) twice


@pytest.mark.slow
def test_improving_agent_keeps_near_its_best_attempt() -> None:
    found = attempts(improve_best, 6, games=[GAME], runs=3, feedback="trajectory")
    blind = attempts(draw_randomly, 6, games=[GAME], runs=3)
    assert found.success.sum() > blind.success.sum()

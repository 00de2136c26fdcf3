import numpy as np
import pytest

from iphyre_jax import load_scene, simulate
from iphyre_jax.analyses import slack
from iphyre_jax.analyses.search import PAIR_STEPS, Plans, Tried, _changes, _climb, _grid, decide, neighbours
from iphyre_jax.analyses.slack import least_slack, slack_of, widest_plan
from iphyre_jax.scenes import Scene

FPS, RESETS = 10, 2


def test_grid_is_whole_and_has_no_equal_steps() -> None:
    plans = np.concatenate(list(_grid(3, 2, 5)))
    pairs = {tuple(plan) for plan in plans.tolist()}
    assert len(pairs) == len(plans) == 3 * 4 * 3  # three pairs of blocks, steps 1 to 4, no two equal
    assert all(sum(step >= 0 for step in plan) == 2 for plan in pairs)
    assert {step for plan in pairs for step in plan} == {-1, 1, 2, 3, 4}


def test_neighbours_stay_in_the_episode_and_never_add_a_removal() -> None:
    best = np.array([[1, 149, -1], [70, -1, -1]])
    plans = neighbours(np.random.default_rng(0), best, 500, 30.0, 150)
    assert (plans[:, 2] == -1).all()
    assert ((plans == -1) | ((plans >= 1) & (plans <= 149))).all()


def test_best_plans_are_of_many_sets_and_none_twice() -> None:
    tried = Tried(load_scene("support"), FPS, RESETS)
    tried.plans = np.array([[k, 9] for k in range(1, 8)] * 2 + [[-1, 3], [-1, -1]])
    tried.reward = -np.arange(16.0)
    best = tried.best(6).tolist()
    assert best == [[1, 9], [2, 9], [3, 9], [4, 9], [-1, 3], [-1, -1]]


def test_decision_cuts_what_comes_after_the_end() -> None:
    tried = Tried(load_scene("support"), FPS, RESETS)
    tried.play(np.array([[8, 14], [8, 13], [149, 148], [-1, -1]]))
    plan, reward, success, steps = decide(tried)
    again = simulate("support", [plan], fps=FPS, resets=RESETS, dtype="float64")
    assert success
    assert (again.reward[0], again.steps[0]) == (reward, steps)
    assert (plan < steps).all()
    assert reward == max(tried.reward) == pytest.approx(977.6)


def test_slack_ends_where_the_game_is_no_longer_solved() -> None:
    scene, plan = load_scene("support"), np.array([8, 14])
    widths = slack_of(scene, plan, FPS, RESETS)
    for slot, width in enumerate(widths):
        every = np.repeat(plan[None], 149, axis=0)
        every[:, slot] = np.arange(1, 150)
        solved = np.flatnonzero(simulate(scene, every, fps=FPS, resets=RESETS, dtype="float64").success) + 1
        gaps = np.split(solved, np.flatnonzero(np.diff(solved) > 1) + 1)
        own = next(part for part in gaps if plan[slot] in part)
        assert width == pytest.approx(len(own) / FPS)
    assert slack_of(scene, np.array([8, -1]), FPS, RESETS)[1] is None


@pytest.mark.parametrize("fps", [10, 60])
def test_the_widest_plan_is_found_far_from_the_known_ones(fps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A game that is solved in a narrow box of steps, and in a wide diamond elsewhere: the middle of that is widest."""

    def play(scene: Scene, plans: Plans, *_: object) -> tuple[None, np.ndarray, None]:
        first, second = (plans / fps).T
        narrow = (np.abs(first - 1.2) < 0.35) & (np.abs(second - 2.1) < 0.15)
        return None, narrow | (np.abs(first - 7) + np.abs(second - 8.5) < 3.01), None

    monkeypatch.setattr(slack, "play_plans_of", play)
    scene, known = load_scene("support"), np.array([12, 21]) * fps // 10
    assert least_slack(slack_of(scene, known, fps, RESETS)) < 0.35
    widest, widths = widest_plan(scene, known[None], fps, RESETS, 0)
    assert widest.tolist() == [7 * fps, 8.5 * fps]
    assert slack_of(scene, widest, fps, RESETS) == widths == pytest.approx([6 + 1 / fps] * 2)


def test_a_climb_ends_at_the_best_of_all_plans() -> None:
    every = Tried(load_scene("support"), FPS, RESETS)
    for removals in (1, 2):
        for plans in _grid(2, removals, 60):
            every.play(plans)
    climbed = Tried(load_scene("support"), FPS, RESETS)
    climbed.play(np.array([[40, 55]]))
    assert climbed.success.all()
    assert climbed.reward.max() < every.reward.max() - 1
    _climb(climbed)
    assert climbed.reward.max() == every.reward.max()


def test_changes_are_of_one_removal_or_of_two_by_a_few_steps() -> None:
    plan = np.array([20, -1, 3])
    changes = _changes(plan, 30)
    assert len(changes) == 3 * 31 + (2 * PAIR_STEPS + 1) ** 2
    assert ((changes == -1) | (changes >= 1)).all()
    assert ((changes != plan).sum(axis=1) <= 2).all()
    assert {*changes[:31, 0].tolist()} == {-1, *range(1, 31)}

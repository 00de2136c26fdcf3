"""The random plans: what chipmunk's measurements were made on."""

import numpy as np
import pytest

from iphyre_jax import GAMES, load_scene
from parity.plans import EARLY_LIMIT, LATE_LIMIT, random_plans, random_times, to_steps


def test_plan_zero_does_nothing_and_every_other_one_something() -> None:
    for game in GAMES:
        times = random_times(load_scene(game), 20, seed=3)
        assert np.isnan(times[0]).all()
        assert np.isfinite(times[1:]).any(axis=1).all()


def test_any_number_of_blocks_and_every_block_is_drawn() -> None:
    scene = load_scene("multi_ball_hole")
    removed = np.isfinite(random_times(scene, 200, seed=0)[1:])
    slots = len(scene.eliminable_blocks)
    assert set(removed.sum(axis=1)) == set(range(1, slots + 1))
    assert removed.any(axis=0).all()


def test_times_lie_in_their_set() -> None:
    scene = load_scene("hole")
    early = random_times(scene, 300, seed=0)
    late = random_times(scene, 300, seed=0, plan_set="late")
    assert np.nanmin(early) > 0
    assert 0.9 * EARLY_LIMIT < np.nanmax(early) <= EARLY_LIMIT
    assert np.nanmin(late) == 0
    assert 0.9 * LATE_LIMIT < np.nanmax(late) < LATE_LIMIT
    assert (to_steps(late, 10) == 0).any()


def test_a_seed_gives_the_same_plans_and_another_others() -> None:
    scene = load_scene("hole")
    np.testing.assert_array_equal(random_plans(scene, 9, 60, seed=5), random_plans(scene, 9, 60, seed=5))
    assert (random_plans(scene, 9, 60, seed=5) != random_plans(scene, 9, 60, seed=6)).any()


def test_games_with_equally_many_blocks_get_different_plans() -> None:
    one, other = load_scene("support"), load_scene("pendulum")
    assert len(one.eliminable_blocks) == len(other.eliminable_blocks)
    assert (random_plans(one, 9, 60, seed=5) != random_plans(other, 9, 60, seed=5)).any()


@pytest.mark.parametrize(("seconds", "fps", "step"), [(0.0, 10, 0), (0.05, 10, 1), (0.5, 10, 5), (1.01, 60, 61)])
def test_a_time_becomes_the_first_step_not_before_it(seconds: float, fps: int, step: int) -> None:
    assert to_steps(np.array([[seconds, np.nan]]), fps).tolist() == [[step, -1]]


def test_nonsense_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^count: "):
        random_times(load_scene("hole"), -1, seed=0)
    with pytest.raises(ValueError, match=r"^seed: "):
        random_times(load_scene("hole"), 1, seed=-1)

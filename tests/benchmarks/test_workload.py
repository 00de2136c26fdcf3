"""The workload of the engines, and how it is shared among processes."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.worker_pool import Engine
from benchmarks.workers.protocol import Job
from benchmarks.workload import MIXED, make_workload
from iphyre_jax import GAMES, load_scene
from iphyre_jax.scenes import scene_from_dict
from parity.plans import random_plans


def test_a_mixture_has_the_plans_of_its_games() -> None:
    games = ("hole", "fill", "support")
    workload = make_workload(games, 5, 10, seed=3)
    assert (workload.name, workload.steps, len(workload.plans)) == (MIXED, 150, 15)
    for k, game in enumerate(games):
        plans = random_plans(load_scene(game), 5, 10, 3)
        np.testing.assert_array_equal(workload.plans[k::3, : plans.shape[1]], plans)
        assert (workload.plans[k::3, plans.shape[1] :] == -1).all()
    assert make_workload(["hole"], 5, 60, seed=3).steps == 900


def test_a_slow_engine_plays_the_first_plans_of_a_fast_one() -> None:
    many, few = make_workload(GAMES, 6, 10, seed=0), make_workload(GAMES, 2, 10, seed=0)
    np.testing.assert_array_equal(many.first(len(few.plans)).plans, few.plans)


def test_shares_are_disjoint_complete_and_equal_mixtures() -> None:
    workload = make_workload(("hole", "fill", "support"), 4, 10, seed=0)
    shares = workload.shares(2)
    assert sorted(np.concatenate(shares).tolist()) == list(range(12))
    for rows in shares:
        assert np.bincount(rows % 3).tolist() == [2, 2, 2]


@pytest.mark.parametrize("fps", [10, 60])
@pytest.mark.parametrize("processes", [2, 3, 8])
def test_no_process_waits_long_for_another(processes: int, fps: int) -> None:
    """The first plan of each game removes nothing: it takes longest, most of all beside few others."""
    engine = Engine("any", (), processes, plans_per_game=processes + 1)
    plans = engine.plans_per_game_in(make_workload(GAMES, 1, fps, seed=0))
    workload = make_workload(GAMES, plans, fps, seed=0)
    assert plans % processes == 0
    for rows in workload.shares(processes):
        assert np.bincount(rows % len(GAMES)).tolist() == [plans // processes] * len(GAMES)
        idle = (workload.plans[rows] == -1).all(axis=1).sum()
        assert abs(idle - (workload.plans == -1).all(axis=1).sum() / processes) < 1


def test_a_job_says_all_that_a_worker_needs() -> None:
    workload = make_workload(("hole", "fill"), 3, 10, seed=0)
    job = Job(**workload.job(workload.shares(2)[1]))
    assert [scene_from_dict(scene).name for scene in job.scenes] == ["hole", "fill"]
    assert job.which == [1, 0, 1]
    assert job.plans == workload.plans[[1, 2, 5]].tolist()
    assert (job.fps, job.steps) == (10, 150)

"""Workers play the same episodes, and engines are compared on the same workload."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from benchmarks.measure import compare, ratio
from benchmarks.worker_pool import Engine, WorkerPool
from benchmarks.workers.bare_pymunk import BarePymunk
from benchmarks.workers.ours import Ours
from benchmarks.workers.protocol import EpisodeResults, Job, Player
from benchmarks.workload import make_workload

PYMUNK = (sys.executable, "-m", "benchmarks.workers.bare_pymunk")


def results(player: Player, job: Job) -> EpisodeResults:
    player.load(job)
    player.ready()
    player.play()
    return player.results()


def test_pymunk_and_ours_make_the_same_steps() -> None:
    workload = make_workload(("hole", "support"), 4, 10, seed=1)
    job = Job(**workload.job(np.arange(8)))
    ours, theirs = results(Ours("float64"), job), results(BarePymunk("episodes"), job)
    assert ours.steps == theirs.steps
    assert ours.success == theirs.success
    np.testing.assert_allclose(ours.reward, theirs.reward, rtol=0, atol=1e-9)
    assert any(theirs.success)
    assert not all(theirs.success)


def test_stepping_alone_plays_the_same_episodes() -> None:
    workload = make_workload(("hole", "support"), 4, 10, seed=1)
    job, player = Job(**workload.job(np.arange(8))), BarePymunk("stepping")
    first = results(player, job)
    for _ in range(2):
        player.ready()
        player.play()
        assert player.results() == first
    assert first == results(BarePymunk("episodes"), job)


@pytest.mark.slow
def test_pools_play_in_turns() -> None:
    """Two processes against one; rows come back in their places."""
    workload = make_workload(("hole", "support"), 4, 10, seed=1)
    two, one = Engine("two", (*PYMUNK, "stepping"), 2, 4), Engine("one", (*PYMUNK, "episodes"), 1, 2)
    with WorkerPool(two) as first, WorkerPool(one) as second:
        assert set(first.versions) == {"pymunk"}
        played, seconds = first.load(workload)
        measured = compare([first, second], workload, repeats=3, min_seconds=0.0)
    assert played == results(BarePymunk("episodes"), Job(**workload.job(np.arange(8))))
    assert seconds > 0
    assert [m.engine for m in measured] == ["two", "one"]
    assert [m.episodes for m in measured] == [8, 4]
    assert measured[0].steps == sum(played.steps)
    assert measured[1].steps == sum(played.steps[:4])
    assert measured[1].same_steps == 1.0
    assert all(len(m.seconds) == 3 and min(m.seconds) > 0 for m in measured)
    assert ratio(measured[0], measured[0]) == 1.0


@pytest.mark.slow
def test_a_worker_that_cannot_start_is_reported_in_one_line() -> None:
    with (
        pytest.raises(RuntimeError, match=r"^wrong: a worker ended: ValueError: mode: expected [^\n]*$"),
        WorkerPool(Engine("wrong", (*PYMUNK, "flying"), 1, 1)),
    ):
        pass


@pytest.mark.slow
def test_a_worker_that_dies_between_two_turns_is_reported_in_one_line() -> None:
    with WorkerPool(Engine("dead", (*PYMUNK, "stepping"), 2, 2)) as pool:
        pool.load(make_workload(("hole",), 2, 10, seed=1))
        pool.workers[0].kill()
        pool.workers[0].wait()
        with pytest.raises(RuntimeError, match=r"^dead: a worker ended: no message$"):
            pool.repeat(1)

"""The comparison must see what is wrong: every test here plants an error and looks for it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import Simulation, load_scene
from parity.compare import PlanComparison, binned, compare_plans, in_play, play_errors
from parity.divergences import explain
from parity.engines.trajectory import Trajectory
from parity.plans import random_plans
from parity.play import GameResult, as_simulation, play_reference
from parity.reports.report import as_json, markdown
from parity.reports.summary import summarise
from parity.reports.tables import cells, sections, targets_line
from parity.reports.targets_met import missed_targets
from parity.tolerances import SHARE_LIMITS, TARGETS

SCENE = load_scene("hole")
PLANS = random_plans(SCENE, 8, 10, seed=2)


@pytest.fixture(scope="module")
def references() -> list[Trajectory]:
    return play_reference(SCENE, PLANS, 10, 15.0, 1)


@pytest.fixture
def same(references: list[Trajectory]) -> Simulation:
    return as_simulation(references)


def compared(references: list[Trajectory], ours: Simulation) -> PlanComparison:
    return compare_plans(references, ours, SCENE.dynamic, 10)


def moved(ours: Simulation, plan: int, step: int, by: float) -> Simulation:
    samples = poses(ours).copy()
    samples[plan, step, SCENE.n_blocks, 0] += by
    return replace(ours, samples=samples)


def poses(ours: Simulation) -> np.ndarray:
    assert ours.samples is not None
    return ours.samples


def test_equal_plays_have_no_error(references: list[Trajectory], same: Simulation) -> None:
    row = summarise("hole", [compared(references, same)])
    assert (row.max_error, row.shares, row.faults) == (0.0, (1.0,) * len(SHARE_LIMITS), 0)
    assert (row.same_flag, row.same_step, row.same_bookkeeping) == (1.0, 1.0, 1.0)
    assert missed_targets(10, "float64", [row], row) == []


def test_one_displaced_sample_is_found(references: list[Trajectory], same: Simulation) -> None:
    c = compared(references, moved(same, 3, 5, 2e-5))
    np.testing.assert_allclose(c.error, np.where(np.arange(8) == 3, 2e-5, 0), rtol=1e-6)
    row = summarise("hole", [c])
    assert row.shares == (7 / 8, 7 / 8, 1.0, 1.0)
    assert any("hole: plans within 1e-06 px: 87.50 %" in line for line in missed_targets(10, "float64", [row], row))
    assert missed_targets(10, "float32", [row], row) == []


def test_errors_outside_the_picture_or_after_the_end_do_not_count() -> None:
    theirs = np.array([[[100.0, 100.0, 0.0]], [[100.0, 621.0, 0.0]], [[701.0, 100.0, 0.0]], [[100.0, 100.0, 0.0]]])
    ours = theirs + np.array([3.0, 4.0, 0.0])
    moving = np.array([True])
    np.testing.assert_allclose(play_errors(theirs, ours, moving, 3), [5.0, np.nan, np.nan, 5.0])
    ours[0] = theirs[0]
    np.testing.assert_allclose(play_errors(theirs, ours, moving, 2), [0.0, np.nan, np.nan])


def test_the_borders_of_play_belong_to_it() -> None:
    edge = np.array([[700.0, 620.0, 0.0], [-100.0, 0.0, 0.0], [700.1, 0.0, 0.0], [0.0, 620.1, 0.0]])
    assert in_play(edge).tolist() == [True, True, False, False]


def test_a_pose_that_is_not_finite_is_infinitely_far(references: list[Trajectory], same: Simulation) -> None:
    c = compared(references, moved(same, 2, 4, np.nan))
    assert np.isinf(c.error[2])
    assert not c.same_presence[2]


def test_an_error_over_time_keeps_the_worst_of_every_tenth_of_a_second() -> None:
    errors = np.array([0.0, 1.0, np.nan, 3.0, np.nan, 2.0, np.nan, np.nan])
    np.testing.assert_array_equal(binned(errors, 20, 10), np.array([1, 3, 2, np.nan, np.nan], np.float32))
    np.testing.assert_array_equal(binned(errors, 10, 9)[:4], np.array([0, 1, np.nan, 3], np.float32))


def test_equal_bits_are_counted_in_and_out_of_play(references: list[Trajectory], same: Simulation) -> None:
    assert compared(references, same).identical.all()
    assert not compared(references, moved(same, 3, -1, 1e-13)).identical[3]
    samples = poses(same).copy()
    samples[3, 0, SCENE.n_blocks, 2] = -0.0  # the ball's angle at the start
    other_zero = compared(references, replace(same, samples=samples))
    assert not other_zero.identical[3]
    assert not other_zero.error.any()


def test_a_fault_counts_against_every_share(references: list[Trajectory], same: Simulation) -> None:
    row = summarise("hole", [compared(references, replace(same, fault=np.array([0, 1, 0, 0, 0, 0, 0, 0])))])
    assert (row.faults, row.shares[-1]) == (1, 7 / 8)
    assert any("fault" in line for line in missed_targets(10, "float32", [row], row))


def test_flag_and_step_are_compared_separately(references: list[Trajectory], same: Simulation) -> None:
    solved = np.flatnonzero(same.success)
    later = same.steps.copy()
    later[solved[0]] += 1
    row = summarise("hole", [compared(references, replace(same, steps=later))])
    assert (row.same_flag, row.same_step) == (1.0, 7 / 8)
    assert row.same_step_solved == 1 - 1 / len(solved)
    flags = same.success.copy()
    flags[solved[0]] = False
    row = summarise("hole", [compared(references, replace(same, success=flags))])
    assert (row.same_flag, row.same_step) == (7 / 8, 7 / 8)
    assert row.same_flag_solved == 1 - 1 / len(solved)


def test_shares_of_solved_plans_need_solved_plans(references: list[Trajectory]) -> None:
    unsolved = [reference for reference in references if not reference.success]
    row = summarise("hole", [compared(unsolved, as_simulation(unsolved))])
    assert (row.solved, row.same_flag_solved, row.same_step_solved) == (0, None, None)
    assert "-" in cells(row)


def test_a_block_removed_a_step_too_early_is_found(references: list[Trajectory], same: Simulation) -> None:
    samples = poses(same).copy()
    plan = int(np.argmax(same.eliminations))
    block = int(np.argmax(np.isnan(samples[plan, -1, :, 0])))
    last = int(np.flatnonzero(np.isfinite(samples[plan, :, block, 0]))[-1])
    samples[plan, last, block] = np.nan
    c = compared(references, replace(same, samples=samples))
    assert c.same_presence.tolist() == [i != plan for i in range(8)]
    counts = same.eliminations + (np.arange(8) == plan)
    assert not compared(references, replace(same, eliminations=counts)).same_eliminations[plan]


def test_plays_without_fitting_samples_are_refused(references: list[Trajectory], same: Simulation) -> None:
    with pytest.raises(ValueError, match=r"^samples: expected shape \(8, 151, 7, 3\)"):
        compared(references, replace(same, samples=poses(same)[:, :10]))
    with pytest.raises(ValueError, match=r"^samples: expected sampled plays"):
        compared(references, replace(same, samples=None))


def test_reports_keep_rates_and_types_apart(references: list[Trajectory], same: Simulation) -> None:
    good, bad = compared(references, same), compared(references, moved(same, 3, 5, 0.5))
    plan = explain(SCENE, PLANS, bad, 3, 10, "float64", 150, 1, traced=False)
    results = [
        GameResult(SCENE, 10, "float64", PLANS, bad, diverged=(plan,)),
        GameResult(SCENE, 60, "float64", PLANS, good),
    ]
    tables = sections(results)
    assert [section.title for section in tables] == ["10 fps, float64", "60 fps, float64"]
    assert "MISSED" in targets_line(tables[0])
    assert "every target" in targets_line(tables[1])
    text = markdown(tables, results, {"seed": 2})
    assert text.count("\n## ") == 3  # two tables and the plans that diverge
    document = json.loads(as_json(tables, results, {"seed": 2}))
    assert [table["fps"] for table in document["tables"]] == [10, 60]
    assert [(one["game"], one["fps"], one["plan"]) for one in document["diverged"]] == [("hole", 10, 3)]
    assert document["diverged"][0]["eliminate_at"] == PLANS[3].tolist()


def test_infinite_errors_make_valid_json(references: list[Trajectory], same: Simulation, tmp_path: Path) -> None:
    results = [GameResult(SCENE, 10, "float32", PLANS, compared(references, moved(same, 2, 4, np.nan)))]
    text = as_json(sections(results), results, {})

    def refuse(word: str) -> None:
        raise AssertionError(word)

    assert json.loads(text, parse_constant=refuse)["tables"][0]["overall"]["max_error"] is None


def test_every_rate_and_type_of_the_run_has_targets() -> None:
    assert set(TARGETS) == {(dtype, fps) for dtype in ("float64", "float32") for fps in (60, 10)}

"""``python -m parity.fuzz.random_run``: a run that was killed goes on where it was, and ends with the same report."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from parity.compare import compare_plans
from parity.divergences import DivergedPlan
from parity.fuzz import random_run
from parity.fuzz.random_scenes import random_scene
from parity.play import GameResult, as_simulation, play_reference
from parity.stages import Divergence

SMALL = ["--scenes", "2", "--plans", "2", "--fps", "10", "--workers", "1", "--duration", "3"]


@pytest.mark.slow
def test_a_killed_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [*SMALL, "--out", str(tmp_path)]
    assert random_run.main(options) == 0
    assert "10 fps, float64: every target is met" in capsys.readouterr().out
    report, log = tmp_path / "random.json", tmp_path / "random.part.jsonl"
    first = json.loads(report.read_text())
    assert [row["name"] for row in first["tables"][0]["games"]] == ["0: 1 ball", "1: 2 balls"]
    assert not log.exists()  # the same command compares anew

    right, ran = random_run.compare_games, list[Any]()

    def interrupted(tasks: list[Any], workers: int) -> Any:
        yield next(iter(right(tasks, workers)))
        raise KeyboardInterrupt

    with monkeypatch.context() as cut:
        cut.setattr(random_run, "compare_games", interrupted)
        assert random_run.main(options) == 130
    with log.open("a") as file:
        file.write('{"task": 1, "resu')  # killed while it wrote the second task

    def watched(tasks: list[Any], workers: int) -> Any:
        ran.extend(tasks)
        return right(tasks, workers)

    monkeypatch.setattr(random_run, "compare_games", watched)
    assert random_run.main(options) == 0
    assert len(ran) == 1
    assert json.loads(report.read_text()) == first


@pytest.mark.parametrize("change", ["seed", "code", "header"])
def test_what_another_run_left_is_not_taken(change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options, log, ran = [*SMALL, "--out", str(tmp_path)], tmp_path / "random.part.jsonl", list[Any]()

    def interrupted(tasks: list[Any], workers: int) -> Any:
        ran.extend(tasks)
        raise KeyboardInterrupt

    monkeypatch.setattr(random_run, "compare_games", interrupted)
    assert random_run.main(options) == 130
    header, task = log.read_text(), json.dumps({"task": 0, "results": []}) + "\n"
    log.write_text(header[:40] if change == "header" else header + task)
    if change == "code":
        monkeypatch.setattr(random_run, "_code_sum", lambda: "of other code")
    ran.clear()
    assert random_run.main([*options, *(["--seed", "1"] if change == "seed" else [])]) == 130
    assert len(ran) == 2  # both tasks are played


def test_a_result_is_read_as_it_was_written() -> None:
    scene = random_scene(1)
    plans = np.array([[-1] * len(scene.eliminable_blocks)] * 2, np.int32)
    plays = play_reference(scene, plans, 10, 3.0, 1)
    stage = Divergence(3, "roles", "other", True)
    diverged = DivergedPlan(scene.name, 10, "float64", 1, (-1,), 2.0, (True, 3), (False, 4), 1, None, stage)
    compared = compare_plans(plays, as_simulation(plays), scene.dynamic, 10)
    result = GameResult(scene, 10, "float64", plans, compared, diverged=(diverged,))
    again = random_run._result(json.loads(json.dumps(random_run._record(result))), {scene.name: scene})
    assert (again.scene, again.fps, again.diverged) == (scene, 10, (diverged,))
    np.testing.assert_array_equal(again.eliminate_at, plans)
    for name, values in vars(compared).items():
        if name != "error_over_time":
            np.testing.assert_array_equal(getattr(again.comparison, name), values)
            assert getattr(again.comparison, name).dtype == values.dtype


@pytest.mark.parametrize("option", ["scenes", "plans", "resets", "workers"])
def test_bad_options_get_one_line(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert random_run.main([f"--{option}", "0", "--out", str(tmp_path)]) == 2
    most = " and at most 1000" if option == "resets" else ""
    assert capsys.readouterr().err == f"--{option}: expected a whole number of at least 1{most}, got 0\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--fps"], "--fps: expected at least one value"),
        (["--duration", "0.01"], "--duration: expected a whole number of steps at 60 fps, got 0.01 s"),
        (
            ["--duration", "1e9", "--fps", "10"],
            "--duration: expected at most 8388604 steps for the scene random-0-0, got 10000000000",
        ),
    ],
)
def test_nothing_to_compare_is_no_success(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert random_run.main([*arguments, "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == f"{message}\n"


def test_more_plans_than_memory_holds_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert random_run.main(["--plans", "99999999999", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("--plans: expected a call of at most")
    assert error.count("\n") == 1

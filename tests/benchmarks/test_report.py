"""What a run leaves: options checked, tables, JSON and pictures."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

from benchmarks import __main__ as command
from benchmarks import plots, report, scaling, venvs
from benchmarks.decision_rate import DecisionRate
from benchmarks.engines import FLOAT32, STEPPING
from benchmarks.measure import Measurement
from benchmarks.startup import Startup, one_game_per_size
from iphyre_jax import GAMES, load_scene


def measurement(engine: str, workload: str, seconds: tuple[float, ...]) -> Measurement:
    return Measurement(engine, workload, 10, 8, 1000, 0.5, 480.0, 1.0, 3.0, seconds, seconds, 1000)


@pytest.fixture
def results() -> report.Results:
    found = report.Results(report.run_info({"seed": 0}), problems=["Jax2D is not measured: no network"])
    for workload in ("mixed", "hole", "fill"):
        found.measurements += [
            measurement(STEPPING, workload, (0.5, 0.4, 0.6)),
            measurement(FLOAT32, workload, (0.05, 0.1, 0.06)),
        ]
    found.startups = [Startup("hole", 1, 1024, 5.0, 2.0, (6.0, 2.5))]
    found.scaling_batch = [
        scaling.BatchScaling(64, players, measurement(FLOAT32, "mixed", (seconds,)))
        for players, seconds in (("1 thread", 1.0), ("2 devices", 0.5))
    ]
    found.scaling_size = [scaling.SizeScaling("objects", 3, measurement(FLOAT32, "shelf", (1.0,)))]
    repeats = {"simulate": [(1.0, 2.0)] * 2, "reads": [(1.0, 2.5)] * 2, "keeps": [(4.0, 8.0)] * 2}
    repeats |= {"scan": [(2.0, 4.0)] * 2, "xla": [(1.25, 2.0)] * 2, "spread": [(0.5, 1.0)] * 2}
    compiled = {"scan": 0.1, "xla": 3.0, "spread": 4.0}
    found.decisions = [DecisionRate("hole", 10, 1024, dict.fromkeys(repeats, 2_000_000), 1.0, repeats, compiled)]
    found.bytes_a_world = {"hole": {dtype: scaling.carried_bytes("hole", dtype) for dtype in ("float32", "float64")}}
    return found


def test_json_has_all_that_a_reader_needs(results: report.Results) -> None:
    document = json.loads(report.as_json(results))
    assert {"schema", "machine", "versions", "commit", "options", "problems", "engines"} <= document.keys()
    assert {
        "measurements",
        "startups",
        "scaling_size",
        "scaling_batch",
        "bytes_a_world",
        "decisions",
    } <= document.keys()
    assert {"processor", "cores", "system", "load"} == document["machine"].keys()
    first = document["measurements"][0]
    assert first["steps_per_second"] == pytest.approx({"median": 2000.0, "low": 1000 / 0.6, "high": 2500.0})
    assert first["compile_seconds"] == 2.5
    assert {"engine", "workload", "fps", "episodes", "steps", "solved", "reward", "seconds"} <= first.keys()


def test_tables_show_ratios_repeat_by_repeat(results: report.Results) -> None:
    text = io.StringIO()
    report.show(results, Console(file=text, width=150))
    shown = text.getvalue()
    ours = next(line for line in shown.splitlines() if line.split()[:2] == ["iphyre_jax", "float32"])
    assert ours.split()[2:7] == ["0.0167", "0.01", "-", "0.02", "10"]  # median of 10, 4 and 10
    decisions = next(line for line in shown.splitlines() if line.split()[:2] == ["hole", "2"])
    rates = ["1", "0.50", "1.6", "0.80", "4", "2.00", "2", "1.00", "0.5", "0.25"]
    assert decisions.split()[2:] == [*rates, "100.0", "%", "0.1/3.0"]
    assert "Jax2D is not measured: no network" in shown
    assert ["64", "0.001", "0.002", "2.00", "5e+05", "0"] in [line.split() for line in shown.splitlines()]
    assert ["objects", "3", "0.001", "1e+06"] in [line.split() for line in shown.splitlines()]


def test_a_busy_machine_is_reported() -> None:
    assert report.load_warnings({"machine": {"load": 0.2}}) == []
    assert "load 3.1" in report.load_warnings({"machine": {"load": 3.1}})[0]


@pytest.mark.slow
def test_pictures_are_drawn(results: report.Results, tmp_path: Path) -> None:
    assert [file.name for file in command.save(results, tmp_path)] == [
        "benchmarks.json",
        "engines.png",
        "scaling.png",
    ]
    assert (tmp_path / "engines.png").read_bytes().startswith(b"\x89PNG")
    nothing = report.Results({})
    assert not plots.bars(nothing, tmp_path / "none.png")
    assert not plots.scaling(nothing, tmp_path / "none.png")


def test_state_is_counted_in_bytes() -> None:
    single, double = (scaling.carried_bytes("hole", dtype) for dtype in ("float32", "float64"))
    assert 0 < single < double < 2 * single
    assert single < scaling.carried_bytes("multi_ball_stack", "float32")


def test_every_game_carries_at_most_2_kb_a_world_in_float32() -> None:
    assert {game: size for game in GAMES if (size := scaling.carried_bytes(game, "float32")) > 2048} == {}


def test_what_grows_grows_alone() -> None:
    rows = scaling.sizes()
    assert [scene.n_objects for what, _, scene, _ in rows if what == "objects"] == list(range(3, 13))
    assert [int(scene.dynamic.sum()) for what, _, scene, _ in rows if what == "moving bodies"] == list(range(1, 7))
    assert [round(seconds * scaling.FPS) for what, _, _, seconds in rows if what == "steps"] == list(scaling.STEPS)
    assert {int(scene.dynamic.sum()) for what, _, scene, _ in rows if what != "moving bodies"} == {1}


def test_one_game_stands_for_each_number_of_moving_bodies() -> None:
    sizes = [int(load_scene(game).dynamic.sum()) for game in one_game_per_size()]
    assert sizes == sorted({int(load_scene(game).dynamic.sum()) for game in GAMES})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--repeats", "0"], "--repeats: expected a whole number of at least 1, got 0"),
        (["--seed", "-1"], "--seed: expected a whole number of at least 0, got -1"),
        (["--games", "hol"], "--games: expected one of support, hinder"),
        (["--games", "hole", "fill", "hole"], "--games: expected each value once, got hole fill hole"),
        (["--fps", "60", "60"], "--fps: expected each value once, got 60 60"),
        (["--cores", "5000"], "--cores: expected a whole number of at least 1 and at most"),
        (["--batches", "0"], "--batches"),
        (["--fps"], "--fps"),
    ],
)
def test_bad_options_are_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_an_environment_that_cannot_be_made_is_reported_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(venvs, "FOLDER", tmp_path)
    monkeypatch.setattr(venvs.sys, "executable", str(tmp_path / "python"))
    with pytest.raises(RuntimeError, match=r"^no environment for jax2d: [^\n]*$"):
        venvs.python_of("jax2d")


def test_what_a_killed_run_has_found_is_on_the_disk(results: report.Results, tmp_path: Path) -> None:
    log = command.Log(Progress(disable=True), results, tmp_path)
    log.start("a part", 2)
    done = log.saver(results.startups)
    for count, workload in ((2, "fill"), (3, "mixed")):
        done([Startup(workload, 2, 1024, 6.0, 3.0, (7.0, 3.5))])
        assert len(json.loads((tmp_path / "benchmarks.json").read_text())["startups"]) == count

"""``python -m parity`` from the outside."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from iphyre_jax import GAMES, SPLITS, load_scene
from iphyre_jax.scenes.files import write_scene
from parity.__main__ import Options, main, scenes


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--plans", "0"], "--plans: expected a whole number of at least 1, got 0"),
        (["--resets", "0"], "--resets: expected a whole number of at least 1 and at most 1000, got 0"),
        (["--seed", "-1"], "--seed: expected a whole number of at least 0, got -1"),
        (["--workers", "0"], "--workers: expected a whole number of at least 1, got 0"),
        (["--duration", "nan"], "--duration: expected a whole number of steps at 60 fps, got nan s"),
        (["--duration", "inf"], "--duration: expected a whole number of steps at 60 fps, got inf s"),
        (["--fps"], "--fps: expected at least one value"),
        (["--fps", "60", "60"], "--fps: expected each rate once, got [60, 60]"),
        (["--games", "hole", "hole"], "--games, --scene: expected each scene once"),
        (["--plans", "99999999999"], "--plans: expected a call of at most"),
        (["--name", "a/b"], "--name: expected how names of files begin, got 'a/b'"),
        (["--name", ".."], "--name: expected how names of files begin, got '..'"),
        (["--out", __file__], "File exists"),
        (["--dtype"], "--dtype: expected at least one value"),
        (["--statistics", "-1"], "--statistics: expected seconds, at least 0, got -1.0"),
        (["--perturbations", "0"], "--perturbations: expected numbers between -1 and 1 but not 0, got 0.0"),
        (["--games", "suport"], "suport"),
        (["--scene", "nowhere/missing.json"], "missing.json"),
        (
            ["--games", "multi_ball_lever", "--fps", "10", "--duration", "15000"],
            "--duration: expected at most 131070 steps for the scene multi_ball_lever, got 150000",
        ),
        (["--games", "support", "--duration", "0.01"], "--duration: expected a whole number of steps"),
    ],
)
def test_bad_options_get_one_line(arguments: list[str], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1


def test_scenes_of_one_name_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their rows and charts could not be told apart."""
    files = [tmp_path / "one.json", tmp_path / "other.json"]
    for file in files:
        write_scene(load_scene("hole"), file)
    assert main(["--scene", *map(str, files), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "--games, --scene: expected scenes of different names, got 'hole' twice\n"


def test_without_names_the_forty_games_are_compared() -> None:
    assert scenes(Options()) == list(GAMES)
    assert scenes(Options(unseen=True)) == list(SPLITS["unseen_basic"])
    assert scenes(Options(games=("hole",), scene=(Path("own.json"),))) == ["hole", "own.json"]


@pytest.mark.slow
def test_a_run_leaves_its_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = [
        "--games",
        "support",
        "unseen_hole",
        "--plans",
        "3",
        "--fps",
        "10",
        "--dtype",
        "float64",
        "--statistics",
        "1",
    ]
    assert main([*options, "--workers", "1", "--out", str(tmp_path), "--name", "small"]) == 0
    output = capsys.readouterr().out
    assert "10 fps, float64: every target is met" in output
    document = json.loads((tmp_path / "small.json").read_text())
    (table,) = document["tables"]
    assert [game["name"] for game in table["games"]] == ["support", "unseen_hole"]
    assert table["overall"]["plans"] == 6
    assert {"jax", "numpy", "pymunk", "python"} <= set(document["versions"])
    assert document["arguments"]["seed"] == 0
    assert "| unseen_hole | 3 |" in (tmp_path / "small.md").read_text()
    text = (tmp_path / "small.html").read_text()
    assert document["headline"] in text
    assert text.count('class="chart"') == 2
    assert "Energy, momentum and contacts side by side" in text


@pytest.mark.slow
def test_ctrl_c_ends_the_workers(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "parity", "--games", "hole", "support", "--plans", "100000", "--workers", "2"]
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path)], cwd=root, start_new_session=True, stderr=subprocess.PIPE, text=True
    ) as running:
        deadline = time.monotonic() + 60
        children = Path(f"/proc/{running.pid}/task/{running.pid}/children")
        while len(children.read_text().split()) < 3 and time.monotonic() < deadline:  # the tracker and two workers
            time.sleep(0.1)
        time.sleep(2)
        group = running.pid
        os.killpg(group, signal.SIGINT)  # as a terminal does
        try:
            assert running.wait(30) == 130
        finally:
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)
        assert running.stderr is not None
        assert "interrupted; nothing was written" in running.stderr.read()
    assert not list(tmp_path.iterdir())

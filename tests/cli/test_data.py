"""`iphyre-jax collect`: makes, verifies and converts data sets; one line for every mistake."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax.cli.main import run
from iphyre_jax.data import collect, load_dataset, save_dataset
from iphyre_jax.data.generated import load_generated, save_generated
from iphyre_jax.scenes import load_scene, scene_to_dict, write_scene
from iphyre_jax.viewer.plays import append_play, play_to_json
from iphyre_jax.viewer.recording import record

SMALL = ["collect", "hole", "--successes", "3", "--failures", "4"]


def test_a_data_set_is_made_verified_and_converted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first = tmp_path / "first.npz"
    assert run([*SMALL, "--out", str(first), "--official", str(tmp_path / "lists")]) == 0
    assert f"{first}: 7 plays of 1 scenes, 3 solved, 60 fps" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["first.json", "first.npz", "lists"]
    assert run(["collect", "--verify", str(first)]) == 0
    assert "7 plays, all reproduced" in capsys.readouterr().out
    for command in (SMALL, ["collect"], ["collect", "--source", str(first)]):  # the second asks for all games
        assert run([*command, "--official", str(tmp_path / "lists")]) == 2
        assert "lists/hole is there; expected another folder\n" in capsys.readouterr().err
    assert run(["collect", "--source", str(tmp_path / "lists"), "--out", str(tmp_path / "again.npz")]) == 0
    again = load_dataset(tmp_path / "again.npz")
    assert sorted(again.end_step.tolist()) == sorted(load_dataset(first).end_step.tolist())
    assert "than the files say" not in capsys.readouterr().out


def test_files_of_another_rate_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lists, read = tmp_path / "lists", tmp_path / "new" / "read.npz"
    assert run(["collect", "angle", "--successes", "3", "--failures", "4", "--official", str(lists)]) == 0
    assert run(["collect", "--source", str(lists), "--fps", "10", "--out", str(read)]) == 0
    assert (other := load_dataset(read).manifest["scenes"][0]["other_labels"]) > 0
    assert f"angle: {other} of 7 plays end otherwise than the files say; " in capsys.readouterr().out


def test_names_that_are_no_folders_are_refused_before_anything_is_played(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = {
        "support": "different names, got 'support' twice",
        "..": "names of scenes that can name folders, got '..'",
    }
    for name, message in messages.items():
        write_scene(replace(load_scene("hole"), name=name), tmp_path / "own.json")
        lists = ["--out", str(tmp_path / "a.npz"), "--official", str(tmp_path / "lists")]
        assert run(["collect", str(tmp_path / "own.json"), "support", *lists]) == 2
        assert message in capsys.readouterr().err
        assert [path.name for path in tmp_path.iterdir()] == ["own.json"]


def test_a_wrong_label_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*SMALL, "--out", str(tmp_path / "first.npz")]) == 0
    dataset = load_dataset(tmp_path / "first.npz")
    save_dataset(type(dataset)(**{**vars(dataset), "success": ~dataset.success}), tmp_path / "first.npz")
    capsys.readouterr()
    assert run(["collect", "--verify", str(tmp_path / "first.npz")]) == 1
    assert capsys.readouterr().out == "success: 7 of 7 plays differ (rows 0, 1, 2, 3, 4 ...)\n"


def test_plans_of_a_pretrained_policy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--distribution", "policy", "--policy", "ppo-i", "--max-draws", "20", "--out", str(tmp_path / "p.npz")]
    assert run([*SMALL, *options]) == 0
    made = load_dataset(tmp_path / "p.npz")
    assert len(made)
    assert (made.fps, made.manifest["rule"], made.manifest["resets"]) == (10, "in_advance", 2)  # as it was trained
    times = made.times[~np.isnan(made.times)]
    np.testing.assert_allclose(times, np.rint(times * 10) / 10, atol=1e-6)
    if made.manifest["scenes"][0]["iterations"] is None:
        assert "hole: only " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["collect", "hole"], "out: expected the file to write, --out NAME.npz"),
        ([*SMALL, "--out", "a.npz", "--policy", "ppo-i"], "policy: expected none without --distribution policy"),
        (["collect", "nothing", "--out", "a.npz"], "scene: expected the name of a game"),
        (["collect", "hole", "--out", "a.npz", "--fps", "0"], "fps: expected a positive whole number"),
        (["collect", "--verify", "missing.npz"], "missing.npz"),
        (["collect", "--verify", "a.npz", "hole"], "games: expected none with --verify"),
        (["collect", "--source", "a.npz", "--named", "test"], "source: expected none with --named"),
        (["collect", "--named", "test", "--seed", "9"], "seed: expected none with --named"),
        (["collect", "--named", "test", "--fps", "0"], "fps: expected"),
        ([*SMALL, "--out", "a.npz", "--pose-dtype", "float64"], "pose_dtype: expected none without --sequences"),
        (["collect", "--source", "a.npz", "--out", "b.npz", "--fps", "10"], "fps: expected none with --source"),
        (["collect", "hole", "--out", "a.npz", "--distribution", "policy"], "policy: expected a pretrained policy"),
        (["collect", "--source", "missing.json", "--out", "a.npz"], "missing.json"),
        ([*SMALL, "--out", "a.txt"], "out: expected the path of a data set"),
    ],
)
def test_mistakes_are_one_line(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [SMALL, ["generate", "--count", "1"]])
def test_a_scene_is_never_replaced_by_a_manifest(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "shelves.json"
    scene.write_text(json.dumps(scene_to_dict(load_scene("hole"))))
    before = scene.read_bytes()
    assert run([*command, "--out", str(tmp_path / "shelves.npz")]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"iphyre-jax: out: {scene} is there and is no iphyre_jax/")
    assert message.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["shelves.json"]
    assert scene.read_bytes() == before


def test_a_data_set_is_replaced_only_by_the_command_that_was_killed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A journal beside it tells of the kill, which came after the set was written."""
    made, pool = tmp_path / "made.npz", tmp_path / "pool.npz"
    save_dataset(collect(["hole"], successes=0, failures=1), made)
    save_generated(load_generated("shipped").select([1]), pool)
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    for command, file in ((SMALL, made), (["generate", "--count", "1"], pool)):
        assert run([*command, "--out", str(file)]) == 2
        assert capsys.readouterr().err == f"iphyre-jax: out: {file} is there; expected another name\n"
    assert before == {file: file.read_bytes() for file in tmp_path.iterdir()}
    made.with_suffix(".parts").mkdir()
    assert run([*SMALL, "--out", str(made)]) == 0
    assert len(load_dataset(made)) == 7
    assert not made.with_suffix(".parts").exists()


def test_a_policy_plans_for_a_scene_with_larger_limits(tmp_path: Path) -> None:
    large = {**scene_to_dict(load_scene("hole")), "limits": {"objects": 16, "blocks": 8}}
    (tmp_path / "scene.json").write_text(json.dumps(large))
    options = ["--distribution", "policy", "--policy", "ppo-i", "--successes", "2", "--failures", "0"]
    steps = []
    for name, game in (("small", "hole"), ("large", str(tmp_path / "scene.json"))):
        assert run(["collect", game, *options, "--out", str(tmp_path / f"{name}.npz")]) == 0
        plays = load_dataset(tmp_path / f"{name}.npz")
        assert plays.success.all()
        steps.append(plays.steps)
    np.testing.assert_array_equal(steps[1], np.pad(steps[0], ((0, 0), (0, 2)), constant_values=-1))


def test_plays_are_known_by_what_they_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plays = tmp_path / "plays.txt"
    append_play(plays, play_to_json(record(load_scene("hole"), [60, 60, 60, 60]), "somebody", {}))
    assert run(["collect", "--source", str(plays), "--out", str(tmp_path / "plays.npz")]) == 0
    assert "1 plays of 1 scenes" in capsys.readouterr().out
    lines = tmp_path / "lines.jsonl"  # the official player's, under the usual name of our own
    lines.write_text(json.dumps({"player": "ann", "game": "hole", "episode": 0, "actions": [], "reward": -15.0}) + "\n")
    assert run(["collect", "--source", str(lines), "--out", str(tmp_path / "lines.npz")]) == 0
    assert "1 plays of 1 scenes" in capsys.readouterr().out

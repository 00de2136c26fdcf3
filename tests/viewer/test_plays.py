"""Files of plays: what is written can be read, and each mistake gives one line."""

from __future__ import annotations

import json
import sys
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import Limits, SceneBuilder, load_scene
from iphyre_jax.cli.main import run
from iphyre_jax.paper import paper_rewards
from iphyre_jax.scenes import scene_to_dict
from iphyre_jax.viewer.load_plays import best_plays, load_plays
from iphyre_jax.viewer.plays import append_play, iter_plays, open_plays, play_to_json, read_plays
from iphyre_jax.viewer.recording import record

GOOD = {
    "schema": "iphyre_jax/play",
    "version": 1,
    "agent": "somebody",
    "scene": "hole",
    "plan": [-1, -1, 83, 32],
    "fps": 60,
    "dtype": "float64",
    "resets": 1,
}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    builder = SceneBuilder("<img src=x onerror=alert(1)>")
    builder.block((200, 400), (300, 400), eliminable=True)
    builder.ball((250, 340))
    file = tmp_path / "plays.jsonl"
    for scene, plan in ((load_scene("hole"), [-1, -1, 83, 32]), (builder.build(), [60])):
        append_play(file, play_to_json(record(scene, plan), "<b>", {"attempt": 1}))
    first, second = read_plays(file)
    assert first.scene == load_scene("hole")
    assert second.scene == builder.build()
    assert (first.agent, second.plan) == ("<b>", (60,))
    assert not first.difference(first.record())
    assert first.record().success
    difference = replace(first, result={**(first.result or {}), "steps": 1}).difference(first.record())
    assert difference == "steps 1, now 261"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": "other"}, "schema: expected"),
        ({"version": 2}, "version: expected 1"),
        ({"scene": "../../etc/passwd"}, "scene: expected the name of a game or a scene"),
        ({"scene": {"name": "x"}}, "scene: schema: expected"),
        ({"agent": ""}, "agent: expected"),
        ({"agent": "a\x1b[2Jb"}, "agent: expected"),
        ({"agent": "a\u2028b"}, "agent: expected"),
        ({"agent": "x" * 101}, "agent: expected"),
        ({"plan": [1]}, "plan: expected 4 steps"),
        ({"plan": [-1, -1, 0.5, True]}, "plan[2]: expected a step"),
        ({"plan": [-1, -1, -1, 2**31]}, "plan[3]: expected a step"),
        ({"fps": 0}, "fps: expected"),
        ({"fps": 5000}, "fps: expected at most"),
        ({"dtype": "float16"}, "dtype: expected"),
        ({"resets": 0}, "resets: expected"),
        ({"result": [1]}, "result: expected"),
        ({"extra": 1}, "'extra': expected no such field"),
    ],
)
def test_a_wrong_line_is_named(change: dict[str, object], message: str, tmp_path: Path) -> None:
    file = tmp_path / "plays.jsonl"
    file.write_text(json.dumps(GOOD) + "\n" + json.dumps(GOOD | change) + "\n", "utf-8")
    with pytest.raises(ValueError) as error:
        read_plays(file)
    assert str(error.value).startswith(f"{file}: line 2: ")
    assert message in str(error.value)


def test_a_line_whose_scene_has_no_room_for_its_steps_is_named(tmp_path: Path) -> None:
    builder = SceneBuilder("fourteen", Limits(14, 6))
    for k in range(14):
        builder.ball((20 + 42 * k, 340))
    file = tmp_path / "plays.jsonl"
    for fps in (546, 1000):
        append_play(file, GOOD | {"scene": scene_to_dict(builder.build()), "plan": [], "fps": fps})
    with pytest.raises(ValueError) as error:
        load_plays(file)
    wanted = "line 2: fps: expected at most 8190 steps in 15 s for this scene, got 15000"
    assert str(error.value) == f"{file}: {wanted}"


@pytest.mark.parametrize("content", [b"[", b"\xff\n", b"1\n", b'{"a":1,"a":2}\n', b"[" * 50_000, b" " * 200_000])
def test_what_is_no_json_is_named(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "plays.jsonl"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"line 1: .*expected") as error:
        read_plays(file)
    assert "\n" not in str(error.value)


def test_damaged_lines_are_skipped_with_one_warning_that_names_them(tmp_path: Path) -> None:
    file = tmp_path / "plays.jsonl"
    good = json.dumps(GOOD).encode() + b"\n"
    damaged = (
        good[:50] + b"\n",
        b"\xff\xfe\n",
        b"\0" * 500 + b"\n",
        b"x" * 250_000 + b"\n",
        b"17\n",
        b"[" * 90_000 + b"\n",
    )
    file.write_bytes(good + b"".join(line + good for line in damaged))
    with pytest.warns(RuntimeWarning) as caught:
        plays = read_plays(file)
    assert len(plays) == len(damaged) + 1
    (warning,) = caught
    assert str(warning.message) == f"{file}: skipped 6 damaged lines (2, 4, 6, 8, 10 ...)"


def test_an_attempt_that_was_glued_to_half_a_line_is_read(tmp_path: Path) -> None:
    """As earlier versions wrote it: it was confirmed to the player."""
    file = tmp_path / "plays.jsonl"
    good = json.dumps(GOOD)
    for length in range(1, len(good) + 1):
        file.write_text(f"{good}\n{good[:length]}{good}\n", "utf-8")
        assert [play.plan for play in read_plays(file)] == [(-1, -1, 83, 32)] * 2


def test_files_of_any_length_are_read(tmp_path: Path) -> None:
    file = tmp_path / "plays.jsonl"
    file.write_text((json.dumps(GOOD) + "\n") * 10_001, "utf-8")
    assert sum(1 for _ in iter_plays(file)) == 10_001
    assert len(load_plays(file)) == 10_001


@pytest.mark.parametrize(
    "content", [b"GIF89a\x01\x00", b"a,b\n1,2\n", b'{"schema": "iphyre_jax/scene", "version": 1}\n', b"x" * 300_000]
)
def test_attempts_are_not_added_to_something_else(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "plays.jsonl"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"plays\.jsonl: expected a file of plays, got something else"):
        open_plays(file)
    assert file.read_bytes() == content
    with pytest.raises(ValueError, match="expected a file of plays, got something that is no file"):
        open_plays(tmp_path)


def test_the_best_plans_are_for_the_forty_games() -> None:
    from iphyre_jax import GAMES

    assert tuple(best_plays()) == GAMES
    for game in ("support", "hole", "noisy_hole"):  # all forty: make test-browser
        assert not best_plays()[game].difference(best_plays()[game].record())
    solved = [play.result["solved"] for play in best_plays().values() if play.result]
    assert solved == [True] * 40


def test_figures_are_the_papers() -> None:
    hole = paper_rewards("hole")
    assert hole["human"] == 966.08
    assert hole["oracle_split"] == 976.06
    assert hole["agents"]["PPO-I"] == 949.7  # type: ignore[index]
    assert paper_rewards("unseen_hole") == paper_rewards("nothing") == {}


def write_run(folder: Path, plan: object) -> Path:
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps({"settings": {"fps": 10, "resets": 2, "dtype": "float64"}}), "utf-8")
    (folder / "evaluation.json").write_text(json.dumps({"games": [{"game": "support", "plan": plan}]}), "utf-8")
    return folder


def test_a_run_folder_is_a_source(tmp_path: Path) -> None:
    run = write_run(tmp_path / "one <b>", [0.1, 0.2])
    (play,) = load_plays(run)
    assert (play.agent, play.plan, play.fps, play.resets) == ("one <b>", (1, 2), 10, 2)
    assert play.record().reward == 977.6


def test_a_scene_without_removable_blocks_has_an_empty_plan(tmp_path: Path) -> None:
    builder = SceneBuilder("falls by itself")
    builder.ball((250, 340))
    run = write_run(tmp_path / "run", [0.1, 0.2])
    of = json.loads((run / "evaluation.json").read_text("utf-8"))
    of["games"].append({"game": "falls by itself", "plan": [], "scene": scene_to_dict(builder.build())})
    (run / "evaluation.json").write_text(json.dumps(of), "utf-8")
    assert [play.plan for play in load_plays(run)] == [(1, 2), ()]


def test_a_scene_with_the_name_of_a_game_is_of_no_split(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plays.jsonl"
    other = scene_to_dict(replace(load_scene("support"), name="hole"))
    file.write_text(json.dumps(GOOD | {"scene": other, "plan": [-1, -1]}) + "\n", "utf-8")
    assert run(["render", str(file), "--split", "basic", "-o", str(tmp_path / "a.png")]) == 2
    assert "game: expected a game with plays in" in capsys.readouterr().err


@pytest.mark.parametrize("plan", [None, [], ["x", None], [1e9, None], [-1, None]])
def test_a_wrong_run_folder_is_named(plan: object, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"games\[0\]: plan: expected"):
        load_plays(write_run(tmp_path / "run", plan))
    with pytest.raises(FileNotFoundError, match=r"config.json: expected this file of a run folder"):
        load_plays(tmp_path)


def test_the_command_line_renders_replays_and_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plays = tmp_path / "plays.jsonl"
    plays.write_text(json.dumps(GOOD) + "\n" + json.dumps(GOOD | {"plan": [-1, -1, -1, -1]}) + "\n", "utf-8")
    out = tmp_path / "out.png"
    assert run(["render", "hole", "--plan", "-", "-", "1.38", "0.53", "-o", str(out), "--size", "64"]) == 0
    assert "hole: solved after 261 steps, reward 975.6500" in capsys.readouterr().out
    other_name = tmp_path / "plays.txt"
    other_name.write_bytes(plays.read_bytes())
    for what in (["basic"], [str(plays)], [str(plays), "--game", "hole"], [str(other_name)]):
        out.unlink()
        assert run(["render", *what, "-o", str(out), "--size", "64"]) == 0
        assert out.is_file()
    page = tmp_path / "replay.html"
    assert run(["replay", str(plays), "-o", str(page)]) == 0
    assert "2 plays" in capsys.readouterr().out
    assert run(["score", str(plays)]) == 0
    printed = capsys.readouterr()
    assert "somebody at 60 steps a second, float64, reset 1" in printed.out
    assert "975.65" in printed.out
    assert "966.08" in printed.out  # the paper's people
    assert not printed.err
    assert run(["evaluate", str(plays)]) == 0  # as it was called before
    again = capsys.readouterr()
    assert again.out == printed.out
    assert again.err == f"iphyre-jax: FutureWarning: `evaluate {plays}` is deprecated; use `iphyre-jax score {plays}`\n"


def test_scenes_of_one_name_are_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scenes that are drawn on the page are all called "my scene" at first."""
    hole = load_scene("hole")
    moved = replace(hole, blocks=hole.blocks + 5)
    plays, out = tmp_path / "plays.jsonl", tmp_path / "out.png"
    for scene in (hole, moved):
        append_play(plays, play_to_json(record(scene, [-1, -1, 83, 32]), "somebody", {}))
    assert run(["score", str(plays)]) == 0
    assert [line.split()[:2] for line in capsys.readouterr().out.splitlines() if "hole" in line] == [
        ["hole", "#1"],
        ["hole", "#2"],
    ]
    assert run(["render", str(plays), "--game", "hole", "-o", str(out)]) == 2
    assert (
        capsys.readouterr().err == "iphyre-jax: game: expected plays of one scene, got other scenes named 'hole' too\n"
    )


@pytest.mark.filterwarnings("default")
def test_a_command_says_in_one_line_that_a_file_is_damaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "plays.jsonl"
    file.write_text(f"{json.dumps(GOOD)}\nhalf a li", "utf-8")
    assert run(["score", str(file)]) == 0
    printed = capsys.readouterr()
    assert "975.65" in printed.out
    assert printed.err == f"iphyre-jax: RuntimeWarning: {file}: skipped 1 damaged line (2)\n"
    file.write_bytes(b'{"schema": "iphyre')  # killed while the first line was written
    assert run(["score", str(file)]) == 2
    wanted = f"{file}: expected at least one play, got none; skipped 1 damaged line (1)"
    assert capsys.readouterr().err == f"iphyre-jax: {wanted}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["render", "hol", "-o", "a.png"], "scene: expected the name of a game"),
        (["render", "hole", "-o", "a.bmp"], "out: expected a file name that ends in .png, .gif, .mp4, got 'a.bmp'"),
        (["render", "all", "-o", "a.mp4"], "out: expected a file name that ends in .png, got 'a.mp4'"),
        (["render", "best", "-o", "a.gif"], "out: expected a file name that ends in .png, got 'a.gif'"),
        (["render", "best", "-o", "no/a.png"], "out: expected a file in a folder that exists, got 'no/a.png'"),
        (["render", "hole", "-o", "a.gif", "--hold", "-1"], "hold: expected seconds of at least 0"),
        (["render", "best", "-o", "a.png", "--size", "5"], "size: expected"),
        (["replay", "best", "-o", "no/r.html"], "out: expected a file in a folder that exists, got 'no/r.html'"),
        (["render", "hole", "--plan", "soon", "-o", "a.png"], "plan: expected seconds above 0, or never"),
        (["render", "best", "--game", "nothing", "-o", "a.png"], "game: expected a game with plays in best"),
        (["render", "hole", "--game", "fill", "-o", "a.png"], "game: expected none for hole in a.png, got 'fill'"),
        (["render", "all", "--frame", "3", "-o", "a.png"], "frame: expected none for all in a.png, got 3"),
        (["render", "best", "--fps", "10", "-o", "a.png"], "fps: expected none for best in a.png, got 10"),
        (["render", "best", "--game", "hole", "--columns", "3", "-o", "a.png"], "columns: expected none for best with"),
        (["render", "hole", "--frame", "3", "-o", "a.gif"], "frame: expected none for hole in a.gif, got 3"),
        (["render", "hole", "--hold", "3", "-o", "a.png"], "hold: expected none for hole in a.png, got 3.0"),
        (["world", "film", "hole", "-o", "a.txt"], "out: expected a file name that ends in .html, .png, .gif, .mp4"),
        (["world", "film", "hole", "-o", "a.html", "--errors", "no/e.png"], "errors: expected a file in a folder that"),
        (["world", "plan", "hole", "--seed", "-1"], "seed: expected a whole number of at least 0, got -1"),
        (["compare", "none", "--bars", "a.foo"], "bars: expected a file name that ends in .png, .pdf, .svg"),
        (["replay", "none.jsonl"], "none.jsonl: expected a file of plays"),
        (["replay", "best", "-o", "over.jsonl"], "out: expected a file name that ends in .html, .htm"),
        (["replay", "best", "-o", "/"], "out: expected the name of a file, got the folder '/'"),
        (["replay", "best", "--games", "hole", "nothing"], "games: expected games with plays in the sources, got noth"),
        (["render", "", "-o", "a.png"], "scene: expected "),
        (["render", "best", "--split", "foo", "-o", "a.png"], "split: expected one of basic, noisy, "),
        (["render", "hole", "--hold", "100", "-o", "a.gif"], "hold: expected "),
        (["replay", "best", "--games", "nothing"], "games: expected games with plays"),
        (["evaluate", "none.jsonl"], "none.jsonl: not a run folder"),
        (["score", "none.jsonl"], "none.jsonl: expected a file of plays"),
        (["play", "--port", "70000"], "port: expected"),
        (["play", "--name", "a\x1bb"], "name: expected"),
        (["play", "--attempts", "no/where.jsonl"], "expected a file in a folder that exists"),
        (["play", "--agents", "none.jsonl"], "none.jsonl: expected a file of plays"),
    ],
)
def test_a_mistake_gets_one_line_before_anything_is_played(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def played(*_: object, **__: object) -> None:
        raise AssertionError("a plan was played before the mistake was found")

    monkeypatch.setattr("iphyre_jax.viewer.plays.record", played)
    monkeypatch.setattr("iphyre_jax.cli.viewer.render.record", played)
    with chdir(tmp_path):
        assert run(arguments) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_gets_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    for name in ("films", "frames", "painter", "sheets"):
        monkeypatch.delitem(sys.modules, f"iphyre_jax.viewer.{name}", raising=False)
    assert run(["render", "hole", "-o", str(tmp_path / "a.png")]) == 2
    printed = capsys.readouterr().err
    assert "this command needs the extra 'viewer' (PIL is missing)" in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize("command", [["render", "-o", "a.png"], ["replay"], ["score"]])
def test_a_data_set_is_no_file_of_plays(command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savez(tmp_path / "set.npz", game=np.zeros(1))
    with chdir(tmp_path):
        assert run([command[0], "set.npz", *command[1:]]) == 2
    assert (
        "set.npz: expected a file of plays (JSON lines), a run folder, a policy of the package that plans"
        in capsys.readouterr().err
    )


def test_a_policy_of_the_package_is_a_source() -> None:
    plays = {play.scene.name: play for play in load_plays("ppo-i")}
    assert len(plays) == 50
    assert (plays["hole"].agent, plays["hole"].fps, plays["hole"].resets) == ("ppo-i", 10, 2)
    assert plays["support"].record().reward == pytest.approx(977.6)
    with pytest.raises(ValueError, match=r"^ppo-o\.json: games\[0\]: plan: expected a plan, got none; only agents"):
        load_plays("ppo-o")
    with pytest.raises(FileNotFoundError, match=r"^\.\./weights/ppo-i: expected a file of plays"):
        load_plays("../weights/ppo-i")

"""Evaluation of games and of scenes of one's own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import jax
import pytest

from iphyre_jax.cli import main as cli
from iphyre_jax.cli import train as train_commands
from iphyre_jax.scenes import GAMES, Limits, Scene, load_scene, write_scene
from iphyre_jax.train.algos.registry import init
from iphyre_jax.train.evaluate import OTHER, OWN, Evaluation, evaluate
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import runs
from iphyre_jax.viewer.load_plays import load_plays

CONFIG = TrainConfig(games=("support",), hidden_sizes=(8,), sampled_episodes=4)
STATE = init(CONFIG, jax.random.key(0))


def own(game: str = "support", name: str = "mine") -> Scene:
    """A game under another name: it plays alike, and is no game of the package."""
    return replace(load_scene(game), name=name)


def found(*games: str | Path | Scene) -> Evaluation:
    return evaluate(CONFIG, STATE, games)


def test_a_scene_of_ones_own_is_a_split_of_its_own(tmp_path: Path) -> None:
    write_scene(own(), tmp_path / "mine.json")
    game, unseen, mine = (together := found("support", "unseen_support", tmp_path / "mine.json")).games
    assert (game.split, unseen.split, mine.split) == ("basic", "unseen_basic", OTHER)
    assert (mine.game, mine.greedy, mine.plan) == ("mine", game.greedy, game.plan)
    assert together.splits == ("basic", "unseen_basic", OTHER)
    assert together.mean("sampled", OTHER) == mine.sampled
    assert together.mean("greedy") == game.greedy
    assert found("support", "unseen_support").games == (game, unseen)  # scenes behind change no action
    content = together.to_json()
    assert ["scene" in one for one in content["games"]] == [False, False, True]
    assert set(content["splits"]) == {"basic", "unseen_basic", OTHER}
    trained = replace(CONFIG, games=(str(tmp_path / "mine.json"),))
    (again,) = (alone := evaluate(trained, STATE, [own()])).games
    assert (again.split, again.greedy) == (OWN, mine.greedy)
    with pytest.raises(ValueError, match=rf"^split: expected one that was played, of {OWN}; got 'all'$"):
        alone.mean("greedy")


def test_a_scene_with_the_name_of_a_game_is_not_that_game() -> None:
    (game,) = found(own("hole", "support")).games
    assert (game.game, game.split) == ("support", OTHER)
    with pytest.raises(ValueError, match=r"^games: expected scenes of different names, got 'support' twice$"):
        found("support", own("hole", "support"))


def test_scenes_that_the_networks_have_no_room_for_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^games: expected scenes without limits of their own, for the networks'"):
        found("support", replace(own(), limits=Limits(20, 10)))


def test_the_commands_evaluate_what_a_run_was_trained_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train_commands, "GAMES", ("support",))
    monkeypatch.chdir(tmp_path)
    write_scene(own(), "mine.json")
    write_scene(own(name="other"), "other.json")
    write_scene(load_scene("support"), "support.json")  # a file with a game of the package is that game
    short = ["--preset", "quick", "--updates", "1", "--hidden-sizes", "8", "--out", "run"]
    assert cli.run(["train", "--games", "mine.json", "support.json", *short]) == 0
    assert [game["game"] for game in json.loads(Path("run", runs.EVALUATION).read_bytes())["games"]] == [
        "support",
        "mine",
    ]
    assert cli.run(["evaluate", "run", "--scenes", "other.json", "--attempts", "2"]) == 0
    said = capsys.readouterr().out
    assert (said.count("Own scenes"), said.count("Other scenes")) == (5, 3)  # greedy, sampled; own ones again; attempts
    assert "| trained on | mine.json, support.json, 10 physics" in Path("run", "evaluation.md").read_text()
    assert [(play.scene.name, play.scene == own()) for play in load_plays("run")] == [
        ("support", False),
        ("mine", True),
        ("other", False),
    ]
    assert cli.run(["evaluate", "run", "--scenes", "mine.json", "support.json"]) == 0  # known ones count once
    write_scene(own("support", "hole"), "hole.json")
    monkeypatch.setattr(train_commands, "GAMES", GAMES)
    assert cli.run(["evaluate", "run", "--scenes", "hole.json"]) == 2
    assert "scenes: expected scenes of different names, got 'hole' twice" in capsys.readouterr().err
    monkeypatch.setattr(train_commands, "GAMES", ("support",))
    copy = Path("run/scenes/0/mine.json")
    before = copy.read_bytes()
    write_scene(own("hole"), copy)
    assert cli.run(["evaluate", "run"]) == 2
    assert "games: expected the scene that the run began with" in capsys.readouterr().err
    copy.write_bytes(before)
    assert cli.run(["train", "--games", "mine.json", "support.json", *short[:-1], "two", "--seed", "1"]) == 0
    for name in ("mine.json", "support.json"):
        Path(name).unlink()
    Path("elsewhere").mkdir()
    Path("run").rename("elsewhere/run")  # which has copies of the scenes
    assert cli.run(["evaluate", "elsewhere/run", "--ensemble", "two"]) == 0
    assert cli.run(["evaluate", "elsewhere/run"]) == 0
    assert cli.run(["resume", "elsewhere/run", "--no-evaluate"]) == 0
    assert load_plays("elsewhere/run")[1].scene == own()
    assert cli.run(["compare", "elsewhere/run"]) == 0
    assert "Scenes of your own have no column here" in capsys.readouterr().out
    Path("elsewhere/run/scenes/0/mine.json").rename("mine.json")
    assert cli.run(["resume", "elsewhere/run", "--no-evaluate"]) == 0  # which copies it again
    Path("mine.json").unlink()
    Path("elsewhere/run/scenes/0/mine.json").unlink()
    capsys.readouterr()
    assert cli.run(["evaluate", "elsewhere/run"]) == 2
    assert capsys.readouterr().err.endswith("mine.json: expected a scene file, but there is none\n")
    assert cli.run(["compare", "elsewhere/run"]) == 0  # which plays nothing


def test_a_run_whose_scenes_cannot_be_told_apart_does_not_start(tmp_path: Path) -> None:
    write_scene(own("hole", "support"), tmp_path / "one.json")
    with pytest.raises(ValueError, match=r"^games: expected scenes that are not called as a game of the package, got"):
        replace(CONFIG, games=(str(tmp_path / "one.json"),)).check_start()
    write_scene(own("hole"), tmp_path / "two.json")
    write_scene(own("support"), tmp_path / "three.json")
    two = tuple(str(tmp_path / f"{name}.json") for name in ("two", "three"))
    with pytest.raises(ValueError, match=r"^games: expected scenes of different names, got 'mine' twice$"):
        replace(CONFIG, games=two).check_start()

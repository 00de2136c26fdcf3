"""Whole runs on two games: the folder, interruption, reading it again, evaluation, the command line."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from rich.console import Console

from benchmarks.learning import agents, agents_document
from benchmarks.learning import rows as tables
from iphyre_jax.cli import main as cli
from iphyre_jax.cli import train as train_commands
from iphyre_jax.files import file_sum
from iphyre_jax.train import collect, loop, trainer
from iphyre_jax.train.algos.registry import algorithm
from iphyre_jax.train.evaluate import evaluate
from iphyre_jax.train.reports import compare
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs, manifest, runs
from tests.other_options import other_options

GAMES = ("support", "hole")
TINY = TrainConfig(
    games=GAMES,
    hidden_sizes=(32,),
    updates=3,
    episodes_per_scene=8,
    sampled_episodes=2,
    checkpoint_seconds=0.0,
    learner=PPO(minibatches=2),
)
QUIET = Console(quiet=True)
PNG = b"\x89PNG\r\n\x1a\n"


def assert_same_tree(a: object, b: object) -> None:
    left, right = jax.tree.leaves(a), jax.tree.leaves(b)
    assert len(left) == len(right) > 0
    for x, y in zip(left, right, strict=True):
        if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key):
            x, y = jax.random.key_data(x), jax.random.key_data(y)
        np.testing.assert_array_equal(x, y)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> loop.TrainingResult:
    result = loop.train(TINY, tmp_path_factory.mktemp("runs") / "finished", QUIET)
    evaluation = evaluate(TINY, result.state.learner, GAMES)
    runs.write_evaluation(result.folder, TINY, evaluation, int(result.state.update))
    return result


def without_clock(folder: Path) -> list[dict[str, str]]:
    return [{k: v for k, v in line.items() if k not in trainer.TIMING_COLUMNS} for line in logs.read(folder)]


def copy_of(finished: loop.TrainingResult, folder: Path) -> Path:
    return Path(shutil.copytree(finished.folder, folder))


@pytest.mark.slow
def test_a_run_leaves_its_folder(finished: loop.TrainingResult) -> None:
    assert finished.finished
    names = {entry.name for entry in finished.folder.iterdir()}
    assert names == {"config.json", "metrics.csv", "curve.png", "checkpoints", "evaluation.json", "evaluation.md"}
    assert (finished.folder / "curve.png").read_bytes().startswith(PNG)
    assert checkpoint.names(finished.folder) == ["000002", "000003"]
    assert sorted(entry.name for entry in (finished.folder / checkpoint.FOLDER).iterdir()) == ["000002", "000003"]


def test_metrics_of_every_update(finished: loop.TrainingResult) -> None:
    lines = logs.read(finished.folder)
    assert [int(line["update"]) for line in lines] == [1, 2, 3]
    assert [int(line["episodes"]) for line in lines] == [16, 32, 48]
    assert [int(line["decisions"]) for line in lines] == [16, 32, 48]
    assert all(-75 <= float(line["reward"]) <= 1000 for line in lines)
    assert [bool(line["greedy_reward"]) for line in lines] == [True, False, True]  # first and last update
    assert all(int(line["faults"]) == 0 for line in lines)


def test_results_carry_their_origin(finished: loop.TrainingResult) -> None:
    for name in ("config.json", "evaluation.json"):
        content = json.loads((finished.folder / name).read_text())
        assert content["settings"]["seed"] == TINY.seed
        assert content["settings"]["fps"] == 10
        assert content["settings"]["dtype"] == "float32"
        assert content["agent"].startswith("PPO in-advance, quick preset")
        assert content["agent"].endswith("time_grid head, 10 fps, seed 0")
        assert content["versions"]["jax"] == jax.__version__
        assert content["device"].startswith("cpu")
        assert "commit" in content
    text = (finished.folder / "evaluation.md").read_text()
    for fact in (
        "time_grid head, 10 fps, seed 0",
        "float32",
        f"jax {jax.__version__}",
        "commit",
        "paper: PPO-I",
        "861.6",
    ):
        assert fact in text


def test_evaluation_of_two_games(finished: loop.TrainingResult) -> None:
    content = json.loads((finished.folder / "evaluation.json").read_text())
    assert [game["game"] for game in content["games"]] == list(GAMES)
    assert list(content["splits"]) == ["basic"]  # no mean of forty games without forty games
    for game in content["games"]:
        assert (game["greedy"]["episodes"], game["sampled"]["episodes"]) == (1, 2)
        greedy = game["greedy"]
        expected = 1000 * greedy["success"] - 10 * greedy["eliminations"] - greedy["seconds"]
        np.testing.assert_allclose(greedy["reward"], expected)
    assert [len(game["plan"]) for game in content["games"]] == [2, 4]


@pytest.mark.slow
def test_a_run_is_read_again(finished: loop.TrainingResult) -> None:
    config, state = runs.load(finished.folder, to_resume=True)
    assert config == TINY
    assert_same_tree(state, finished.state)
    config, state = runs.load(finished.folder)  # what plays
    assert_same_tree(state.learner, algorithm(TINY).inference_state(finished.state.learner))
    assert evaluate(config, state.learner, GAMES) == evaluate(TINY, finished.state.learner, GAMES)


@pytest.mark.slow
def test_an_interrupted_run_goes_on_to_the_same_bits_whatever_the_options_of_jax(
    finished: loop.TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Interrupted while the second update is played, then resumed; a line cut short by a kill is written again."""
    real, calls = collect.play_plans, iter(range(100))

    def interrupted(*arguments: Any, **options: Any) -> Any:
        if next(calls) == 2:  # the first update plays twice: its plans, and the greedy ones
            raise KeyboardInterrupt
        return real(*arguments, **options)

    folder = tmp_path / "run"
    with monkeypatch.context() as patched:
        patched.setattr(collect, "play_plans", interrupted)
        result = loop.train(TINY, folder, QUIET)
    assert (result.finished, int(result.state.update), len(logs.read(folder))) == (False, 1, 1)
    assert (folder / "curve.png").read_bytes().startswith(PNG)
    with (folder / logs.FILE).open("a") as file:
        file.write("2,32,3")
    with other_options():
        resumed = loop.resume(folder, QUIET)
    assert resumed.finished
    assert_same_tree(resumed.state, finished.state)
    assert without_clock(folder) == without_clock(finished.folder)
    seconds = [float(line["seconds"]) for line in logs.read(folder)]
    assert seconds == sorted(seconds)  # of both parts together


@pytest.mark.slow
def test_a_run_without_a_checkpoint_begins_again(finished: loop.TrainingResult, tmp_path: Path) -> None:
    folder = copy_of(finished, tmp_path / "run")
    shutil.rmtree(folder / checkpoint.FOLDER)
    assert_same_tree(loop.resume(folder, QUIET).state, finished.state)
    assert without_clock(folder) == without_clock(finished.folder)


def test_a_folder_in_use_is_refused(finished: loop.TrainingResult, capsys: pytest.CaptureFixture[str]) -> None:
    before = (finished.folder / "metrics.csv").read_text()
    with pytest.raises(ValueError, match="expected a new or empty folder"):
        loop.train(TINY, finished.folder, QUIET)
    assert cli.run(["train", "--out", str(finished.folder)]) == 2
    assert "expected a new or empty folder" in capsys.readouterr().err
    assert (finished.folder / "metrics.csv").read_text() == before


def test_a_read_only_folder_is_not_evaluated(
    finished: loop.TrainingResult, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its games would be played first, for minutes."""
    monkeypatch.setattr(train_commands, "evaluate", lambda *_: pytest.fail("it plays"))
    monkeypatch.setattr("os.access", lambda path, mode: path != finished.folder)  # root may write everywhere
    assert cli.run(["evaluate", str(finished.folder)]) == 2
    assert capsys.readouterr().err.startswith(f"iphyre-jax: {finished.folder}: expected a folder that can be written")


def test_damaged_folders_get_one_line(finished: loop.TrainingResult, tmp_path: Path) -> None:
    cases = {
        "missing": "there is no config.json",
        "not_json": "config.json: expected JSON",
        "other_schema": "config.json: schema: expected",
        "other_version": "config.json: version: expected 3, got 1",
        "bad_setting": "config.json: fps: expected a multiple of 10",
        "no_checkpoint": "there is no checkpoint",
        "other_settings": "it belongs to other settings",
    }
    content = json.loads((finished.folder / "config.json").read_text())
    settings = content["settings"]
    changes: dict[str, dict[str, Any]] = {
        "other_schema": {"schema": "something else"},
        "other_version": {"version": 1},
        "bad_setting": {"settings": {**settings, "fps": 15}},
        "other_settings": {"settings": {**settings, "hidden_sizes": [31]}},
    }
    for name, message in cases.items():
        if name != "missing":
            copy_of(finished, tmp_path / name)
        if name in changes:
            (tmp_path / name / "config.json").write_text(json.dumps({**content, **changes[name]}))
        if name == "not_json":
            (tmp_path / name / "config.json").write_text("{")
        if name == "no_checkpoint":
            shutil.rmtree(tmp_path / name / checkpoint.FOLDER)
        with pytest.raises((ValueError, FileNotFoundError)) as caught:
            runs.load(tmp_path / name)
        assert message in str(caught.value)
        assert str(tmp_path / name) in str(caught.value)
        assert "\n" not in str(caught.value)


def largest(folder: Path) -> Path:
    files = [file for file in (folder / "state").rglob("*") if file.is_file()]
    return max(files, key=lambda file: file.stat().st_size)


DAMAGE = {
    "bit flip": (lambda c: flip(largest(c)), "does not have the SHA-256 sum of the manifest"),
    "manifest": (lambda c: flip(c / "manifest.json"), "manifest.json does not have the SHA-256 sum"),
    "sum": (lambda c: flip(c / "manifest.sha256"), "manifest.json does not have the SHA-256 sum"),
    "truncation": (lambda c: largest(c).write_bytes(largest(c).read_bytes()[:-1]), "bytes, not"),
    "missing": (lambda c: largest(c).unlink(), "is missing"),
    "stranger": (lambda c: (c / "state" / "more").write_text("x"), "state/more was not written with it"),
    "renamed": (lambda c: c.rename(c.with_name("000009")), "expected the checkpoint of 9 updates, got that of 3"),
}


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


@pytest.mark.slow
@pytest.mark.parametrize("case", DAMAGE)
def test_a_damaged_checkpoint_is_refused_and_the_last_good_one_offered(
    case: str, finished: loop.TrainingResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(finished, tmp_path / "run")
    damage, message = DAMAGE[case]
    damage(folder / checkpoint.FOLDER / "000003")
    for command in ("resume", "evaluate"):
        assert cli.run([command, str(folder)]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.endswith("the last good one is 000002: --checkpoint 000002\n")
        assert said.count("\n") == 1
    assert_same_tree(loop.resume(folder, QUIET, "000002").state, finished.state)
    assert without_clock(folder) == without_clock(finished.folder)


def test_other_versions_are_evaluated_but_not_resumed(finished: loop.TrainingResult, tmp_path: Path) -> None:
    folder = copy_of(finished, tmp_path / "run")
    for name in checkpoint.names(folder):
        path = folder / checkpoint.FOLDER / name / manifest.MANIFEST
        content = json.loads(path.read_text())
        content["versions"]["jax"] = "0.1.0"
        path.write_text(json.dumps(content))
        path.with_name(manifest.SUM).write_text(f"{file_sum(path)}\n")
    assert runs.load(folder)[0] == TINY
    with pytest.raises(ValueError, match=r"written with jax 0\.1\.0, here is jax .*: it can be evaluated, not resumed"):
        loop.resume(folder, QUIET)


def test_runs_are_compared(finished: loop.TrainingResult, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    second = copy_of(finished, tmp_path / "second")
    content = json.loads((second / "config.json").read_text())
    content["settings"]["seed"] = 1
    (second / "config.json").write_text(json.dumps(content))
    pictures = [tmp_path / "curves.png", tmp_path / "bars.png"]
    command = ["compare", str(finished.folder), str(second), "--curves", str(pictures[0]), "--bars", str(pictures[1])]
    assert cli.run(command) == 0
    assert "PPO-I" in capsys.readouterr().out
    assert all(picture.read_bytes().startswith(PNG) for picture in pictures)
    assert cli.run(["compare", str(finished.folder), str(finished.folder)]) == 2
    assert "expected different seeds" in capsys.readouterr().err
    found = compare.rows([compare.read(finished.folder), compare.read(second)])
    assert [len(row.seeds) for row in found] == [2]
    (row,) = found
    assert row.summary("greedy", "noisy") is None


def test_results_name_what_is_missing(finished: loop.TrainingResult, tmp_path: Path) -> None:
    table = tables.rows()
    assert len(table) == 14  # the paper's twelve, and two of our own
    of_paper = tables.rows("paper")
    assert [f"{name}-paper" for name in list(table)[:12]] == list(of_paper)
    for config in (*table.values(), *of_paper.values()):
        config.check()
    text = agents_document.document([compare.read(finished.folder)], ["ppo-i seed 1"], tmp_path, "results")
    for part in ("Still missing: ppo-i seed 1.", "## 10 fps", "PPO-I quick", "paper: PPO-I", "### Time", "jaxlib"):
        assert part in text
    assert "## 60 fps" not in text
    names = sorted(entry.name for entry in tmp_path.iterdir())
    assert names == ["results-bars-10fps.png", "results-curves-10fps.png"]
    run = compare.read(finished.folder)
    assert agents_document.seconds_to_paper(run) == float("inf")  # three updates of sixteen episodes
    (copy_of(finished, tmp_path / "other") / runs.EVALUATION).unlink()
    with pytest.raises(ValueError, match="expected the settings of this row"):
        agents.run_row(tmp_path / "other", tmp_path / "none", table["ppo-i"], QUIET)


def test_a_published_run_is_not_trained_again(
    finished: loop.TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agents, "ALL_GAMES", GAMES)
    arguments = agents.Arguments(root=tmp_path / "nothing", out=tmp_path / "out", seeds=1)
    published = arguments.published / "tiny" / "seed-0"
    assert not agents.is_published(published, TINY)
    agents.run_row(finished.folder, published, TINY, QUIET)  # evaluated already: it is only published
    assert {file.name for file in published.iterdir()} == {"config.json", "metrics.csv", "evaluation.json"}
    assert agents.is_published(published, TINY)
    monkeypatch.setattr(agents, "rows", lambda _: {"tiny": TINY})
    agents.main(arguments)
    assert not arguments.root.exists()
    assert compare.read(published).games == compare.read(finished.folder).games
    text = (arguments.out / "results.md").read_text()
    assert "PPO-I quick" in text
    assert not agents.is_published(published, replace(TINY, updates=TINY.updates + 1))  # out of date


@pytest.mark.parametrize(("updates", "games"), [(1, GAMES), (TINY.updates, GAMES[:1])])
def test_an_evaluation_of_a_part_is_made_anew(
    finished: loop.TrainingResult,
    updates: int,
    games: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`iphyre-jax evaluate` had been used on the folder: on an older checkpoint, or on some of the games."""
    monkeypatch.setattr(agents, "ALL_GAMES", GAMES)
    folder = copy_of(finished, tmp_path / "run")
    evaluation = evaluate(TINY, finished.state.learner, games)
    runs.write_evaluation(folder, TINY, evaluation, updates)
    runs.publish(folder, tmp_path / "published")
    assert not agents.is_published(tmp_path / "published", TINY)
    agents.run_row(folder, tmp_path / "published", TINY, QUIET)
    assert agents.is_published(tmp_path / "published", TINY)
    assert compare.read(tmp_path / "published").games == compare.read(finished.folder).games


def test_only_whole_runs_with_the_settings_of_the_row_ship(
    finished: loop.TrainingResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agents, "ALL_GAMES", GAMES)
    monkeypatch.setattr(compare.Evaluated, "scores", lambda *_: [1.0])
    arguments = agents.Arguments(root=tmp_path, weights=tmp_path / "weights", seeds=1)
    folder = copy_of(finished, tmp_path / "tiny" / "seed-0")
    agents.export_best(arguments, "tiny", replace(TINY, episodes_per_scene=TINY.episodes_per_scene * 2))
    runs.write_evaluation(folder, TINY, evaluate(TINY, finished.state.learner, GAMES[:1]), TINY.updates)
    agents.export_best(arguments, "tiny", TINY)
    assert not (tmp_path / "weights").exists()
    runs.write_evaluation(folder, TINY, evaluate(TINY, finished.state.learner, GAMES), TINY.updates)
    agents.export_best(arguments, "tiny", TINY)
    assert {file.name for file in (tmp_path / "weights").iterdir()} == {"tiny.npz", "tiny.json"}


@pytest.mark.slow
def test_command_line_trains_resumes_and_evaluates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(train_commands, "GAMES", GAMES)  # the forty are for `make run`
    folder = tmp_path / "run"
    small = ["--games", *GAMES, "--updates", "2", "--episodes-per-scene", "8", "--hidden-sizes", "16"]
    chosen = ["--agent", "a2c", "--strategy", "in-advance", "--minibatches", "2", "--sampled-episodes", "2"]
    assert cli.run(["train", *chosen, "--out", str(folder), *small]) == 0
    first = json.loads((folder / "evaluation.json").read_text())
    assert first["updates trained"] == "2 of 2, 32 episodes"
    for command in ("evaluate", "resume"):
        assert cli.run([command, str(folder)]) == 0
        assert json.loads((folder / "evaluation.json").read_text())["games"] == first["games"]
    assert "paper: PPO-I" in capsys.readouterr().out

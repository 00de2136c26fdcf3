"""What a run says and refuses when it goes on: a policy that diverged, lost lines, changed scenes, another machine."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.scenes import load_scene, write_scene
from iphyre_jax.train import loop, trainer
from iphyre_jax.train.algos.base import not_finite
from iphyre_jax.train.settings.agents import DQN, PPO
from iphyre_jax.train.settings.run import TrainConfig, preset
from iphyre_jax.train.storage import checkpoint, logs, runs

CONFIG = TrainConfig(
    games=("support",),
    hidden_sizes=(8,),
    updates=2,
    episodes_per_scene=8,
    checkpoint_seconds=0.0,
    learner=PPO(minibatches=2),
)


def spoken(console: Console) -> str:
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


@pytest.fixture
def console() -> Console:
    return Console(file=io.StringIO(), width=60)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return loop.train(CONFIG, tmp_path_factory.mktemp("runs") / "finished", Console(quiet=True)).folder


def test_a_policy_that_diverged_ends_the_run_with_its_last_good_state(tmp_path: Path, console: Console) -> None:
    config = replace(CONFIG, learner=PPO(minibatches=2, learning_rate=1e38))
    with pytest.raises(ValueError, match=r"^update \d: .*: expected finite numbers, got NaN or infinity: it diverged$"):
        loop.train(config, tmp_path / "run", console)
    state = runs.load(tmp_path / "run")[1]
    assert not not_finite(state.learner.params)


def test_lost_lines_are_told(finished: Path, tmp_path: Path, console: Console) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "run"))
    lines = (folder / logs.FILE).read_text().splitlines(keepends=True)
    (folder / logs.FILE).write_text("".join([lines[0], *lines[2:]]))
    loop.resume(folder, console)
    assert "expected a line for each of 2 updates, but 1 are missing; the run goes on without them" in spoken(console)


def test_a_folder_may_be_called_anything(tmp_path: Path, console: Console) -> None:
    folder = tmp_path / "a long name [bold] of a sweep with lr[=1] and more[" / "]"
    loop.train(CONFIG, folder, console)
    assert f"Run folder: {folder}\n" in spoken(console)


def test_a_run_goes_on_with_the_scene_that_it_began_with(
    tmp_path: Path, console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_scene(replace(load_scene("support"), name="mine"), tmp_path / "mine.json")
    monkeypatch.chdir(tmp_path)
    folder = loop.train(replace(CONFIG, games=("mine.json",)), tmp_path / "run", console).folder
    monkeypatch.chdir("/")
    assert loop.resume(folder, console).finished  # wherever it is called from
    write_scene(replace(load_scene("hole"), name="mine"), tmp_path / "mine.json")
    loop.resume(folder, console)  # with its copy, whatever lies there now
    (tmp_path / "mine.json").unlink()
    (tmp_path / "mine.json").mkdir()
    loop.resume(folder, console)
    write_scene(replace(load_scene("hole"), name="mine"), folder / "scenes" / "0" / "mine.json")
    with pytest.raises(ValueError, match=r"^games: expected the scene that the run began with, but .*mine\.json was"):
        loop.resume(folder, console)


def test_scenes_that_changed_places_are_others(tmp_path: Path, console: Console) -> None:
    files = [tmp_path / f"{game}.json" for game in ("support", "hole")]
    for file in files:
        write_scene(replace(load_scene(file.stem), name=f"my {file.stem}"), file)
    folder = loop.train(replace(CONFIG, games=tuple(map(str, files))), tmp_path / "run", console).folder
    one, two = (folder / "scenes" / str(place) / file.name for place, file in enumerate(files))
    one.write_bytes((before := two.read_bytes(), two.write_bytes(one.read_bytes()))[0])
    assert one.read_bytes() == before
    with pytest.raises(ValueError, match=r"^games: expected the scene that the run began with, but .* was changed$"):
        loop.resume(folder, console)


def test_another_machine_is_told(
    finished: Path, tmp_path: Path, console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop.resume(Path(shutil.copytree(finished, tmp_path / "same")), console)
    assert "begun on" not in spoken(console)
    here = runs.provenance()
    monkeypatch.setattr(runs, "provenance", lambda: {**here, "machine": "Linux x86_64, 64 cores"})
    loop.resume(Path(shutil.copytree(finished, tmp_path / "other")), console)
    assert 'here "Linux x86_64, 64 cores": the bits may differ' in spoken(console).replace("'", '"')


def test_an_earlier_checkpoint_is_chosen_aloud(finished: Path, tmp_path: Path, console: Console) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "run"))
    assert checkpoint.names(folder) == ["000001", "000002"]
    loop.resume(folder, console, "000001")
    assert "Checkpoint 000002 is removed" in spoken(console)
    assert checkpoint.names(folder) == ["000001", "000002"]


def test_what_cannot_go_on_loses_nothing(
    finished: Path, tmp_path: Path, console: Console, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "run"))
    lines = (folder / logs.FILE).read_text()

    def refuse(*_: object) -> trainer.Trainer:
        raise FileNotFoundError("scene_pool: it was moved")

    monkeypatch.setattr(loop, "Trainer", refuse)
    with pytest.raises(FileNotFoundError, match="it was moved"):
        loop.resume(folder, console, "000001")
    assert checkpoint.names(folder) == ["000001", "000002"]
    assert (folder / logs.FILE).read_text() == lines


def test_decisions_are_counted_as_far_as_a_checkpoint_can() -> None:
    state = trainer.start(CONFIG)._replace(decisions=np.asarray(2**31 - 2, np.int32))
    trained = trainer.Trainer(CONFIG, state)
    assert trained.update_step()["decisions"] == 2**31 - 1
    assert trained.state.decisions.dtype == np.int32


def test_runs_that_begin_in_one_second_have_folders_of_their_own(tmp_path: Path) -> None:
    folders = [runs.new_folder(CONFIG, tmp_path) for _ in range(5)]
    assert len(set(folders)) == 5
    assert all(folder.is_dir() for folder in folders)


@pytest.mark.further
def test_updates_without_a_gradient_step_have_no_losses(tmp_path: Path, console: Console) -> None:
    small = {"games": ("support",), "hidden_sizes": (8,), "updates": 2, "episodes_per_scene": 2}
    learner = DQN(warmup=70, batch_size=8, gradient_steps=1)
    config = replace(preset("dqn", "on-the-fly"), **small, learner=learner)
    folder = loop.train(config, tmp_path / "run", console).folder
    losses = [line[trainer.columns(config)[len(trainer.COLUMNS)]] for line in logs.read(folder)]
    assert losses[0] == ""
    assert float(losses[1]) >= 0

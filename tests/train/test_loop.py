"""Signals, locks and full disks during a run; a trainer that only counts stands in for the real one."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from rich.console import Console

from iphyre_jax.cli import main as cli
from iphyre_jax.train import loop, trainer
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, logs, runs
from tests.robustness.failing_disk import FailingDisk

CONFIG = TrainConfig(
    games=("support", "hole"), hidden_sizes=(8,), updates=3, checkpoint_seconds=0.0, learner=PPO(minibatches=2)
)
OPTIONS = [
    "--preset",
    "quick",
    "--games",
    *CONFIG.games,
    "--hidden-sizes",
    "8",
    "--updates",
    "3",
    "--minibatches",
    "2",
    "--checkpoint-seconds",
    "0",
]
QUIET = Console(quiet=True)
Hook = Callable[[int], None]


class Counting:
    """Counts updates; the state's key depends on all of them. Hooks come before and after the state changes."""

    before: Hook = staticmethod(lambda update: None)
    after: Hook = staticmethod(lambda update: None)

    def __init__(self, config: TrainConfig, state: trainer.RunState, seconds: float) -> None:
        del seconds
        self.config, self.state = config, state

    def update_step(self) -> trainer.Metrics:
        update = int(self.state.update) + 1
        type(self).before(update)
        key = jax.random.fold_in(self.state.key, update)
        self.state = self.state._replace(key=key, update=np.asarray(update, np.int32))
        type(self).after(update)
        return dict.fromkeys(trainer.columns(self.config), 1.0) | {"update": update, "episodes": 8 * update}


@pytest.fixture
def counting(monkeypatch: pytest.MonkeyPatch) -> Iterator[type[Counting]]:
    class Fresh(Counting):
        pass

    # Under nohup the tests inherit that SIGHUP is ignored; training then ignores it too. conftest.py does not
    # do this for all tests, as it does for SIGINT: a hang-up must not end what nohup runs.
    inherited = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    handlers = {number: signal.getsignal(number) for number in loop.SIGNALS}
    monkeypatch.setattr(loop, "Trainer", Fresh)
    yield Fresh
    left = {number: signal.getsignal(number) for number in loop.SIGNALS}
    signal.signal(signal.SIGHUP, inherited)
    assert left == handlers


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(loop, "Trainer", Counting)
        return ending(loop.train(CONFIG, tmp_path_factory.mktemp("runs") / "undisturbed", QUIET).folder)


def ending(folder: Path) -> list[Any]:
    """The bits of the last checkpoint, and the lines of metrics.csv."""
    state = runs.load(folder, to_resume=True)[1]
    leaves = jax.tree.leaves(state._replace(key=jax.random.key_data(state.key)))
    return [*(np.asarray(leaf).tobytes() for leaf in leaves), logs.read(folder)]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_a_signal_ends_training_as_ctrl_c_does(
    number: int, code: int, counting: type[Counting], undisturbed: list[Any], tmp_path: Path
) -> None:
    """In the middle of an update, while a checkpoint is saved, twice at once: what was learned is there."""

    def come(update: int) -> None:
        if update == 2:
            os.kill(os.getpid(), number)
            os.kill(os.getpid(), signal.SIGTERM)  # does nothing more

    counting.before = staticmethod(come)
    folder = tmp_path / "run"
    assert cli.run(["train", "--out", str(folder), *OPTIONS, "--no-evaluate"]) == code
    assert checkpoint.names(folder) == ["000001"]
    assert len(logs.read(folder)) == 1
    counting.before = staticmethod(lambda update: None)
    assert cli.run(["resume", str(folder), "--no-evaluate"]) == 0
    assert ending(folder) == undisturbed


@pytest.mark.slow
def test_signals_wait_while_a_checkpoint_is_saved(
    counting: type[Counting], undisturbed: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, signals = checkpoint.named_arrays, iter([signal.SIGINT, signal.SIGTERM, signal.SIGTERM, signal.SIGINT])

    def come(state: Any) -> Any:  # called in the middle of `save`
        for number in signals:
            os.kill(os.getpid(), number)
            time.sleep(0)
        return real(state)

    monkeypatch.setattr(checkpoint, "named_arrays", come)
    folder = tmp_path / "run"
    assert cli.run(["train", "--out", str(folder), *OPTIONS, "--no-evaluate"]) == 130
    assert checkpoint.names(folder) == ["000001"]
    assert len(logs.read(folder)) == 1
    assert loop.resume(folder, QUIET).finished
    assert ending(folder) == undisturbed


@pytest.mark.slow
def test_an_update_whose_line_is_not_written_is_made_again(
    counting: type[Counting], undisturbed: list[Any], tmp_path: Path
) -> None:
    """The interrupt comes after the state has changed and before its line is in metrics.csv."""

    def come(update: int) -> None:
        if update == 2:
            raise KeyboardInterrupt

    counting.after = staticmethod(come)
    result = loop.train(CONFIG, tmp_path / "run", QUIET)
    assert (result.finished, int(result.state.update), len(logs.read(result.folder))) == (False, 1, 1)
    counting.after = staticmethod(lambda update: None)
    loop.resume(result.folder, QUIET)
    assert ending(result.folder) == undisturbed


def test_a_caller_of_the_library_keeps_its_signals(counting: type[Counting], tmp_path: Path) -> None:
    found = []
    counting.before = staticmethod(lambda update: found.append(signal.getsignal(signal.SIGTERM)))
    loop.train(CONFIG, tmp_path / "run", QUIET)
    assert found == [signal.SIG_DFL] * 3


def test_a_clock_that_goes_back_changes_nothing(
    counting: type[Counting], undisturbed: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = iter(range(2_000_000_000, 0, -86_400))
    monkeypatch.setattr(time, "time", lambda: float(next(times)))
    assert ending(loop.train(CONFIG, tmp_path / "run", QUIET).folder) == undisturbed


HOLD = """
import sys, time
from pathlib import Path
from iphyre_jax.locks import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_one_process_at_a_time_trains_in_a_folder(
    counting: type[Counting], undisturbed: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    counting.before = staticmethod(lambda update: os.kill(os.getpid(), signal.SIGINT) if update == 2 else None)
    assert not loop.train(CONFIG, folder, QUIET).finished
    counting.before = staticmethod(lambda update: None)
    command = [sys.executable, "-c", HOLD, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        before = sorted(folder.rglob("*"))
        assert cli.run(["resume", str(folder)]) == 2
        said = capsys.readouterr().err
        assert f"{folder}: expected a folder that nobody uses, but process {other.pid} on " in said
        assert said.count("\n") == 1
        assert sorted(folder.rglob("*")) == before
        other.kill()
    assert (folder / ".lock").exists()  # left by the kill, and taken over
    loop.resume(folder, QUIET)
    assert ending(folder) == undisturbed
    assert not (folder / ".lock").exists()


DISK = FailingDisk()


@pytest.mark.slow
@pytest.mark.parametrize(("share", "code"), [(0.0, errno.EROFS), (0.08, errno.ENOSPC), (0.6, errno.ENOSPC)])
def test_a_run_on_a_full_disk_ends_with_one_line_and_resumes(
    share: float,
    code: int,
    counting: type[Counting],
    undisturbed: list[Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Every write is tried by `make test-faults`; here one of the folder, of metrics.csv and of a checkpoint."""
    with DISK.failing(tmp_path):
        loop.train(CONFIG, tmp_path / "count", QUIET)
    folder = tmp_path / "run"
    with DISK.failing(tmp_path, int(share * DISK.writes), code):
        assert cli.run(["train", "--out", str(folder), *OPTIONS]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(folder) in said
    assert os.strerror(code) in said
    assert not [entry for entry in folder.rglob("*") if ".part" in entry.name or entry.name == ".lock"]
    begun = (folder / runs.CONFIG).is_file()
    assert (loop.resume(folder, QUIET) if begun else loop.train(CONFIG, folder, QUIET)).finished
    assert ending(folder) == undisturbed


def test_a_checkpoint_needs_room(
    counting: type[Counting], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=900_000))
    assert cli.run(["train", "--out", str(tmp_path / "run"), *OPTIONS]) == 2
    assert "cannot be written: expected 1.2 MB of room on the disk, got 0.9 MB" in capsys.readouterr().err

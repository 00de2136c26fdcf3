"""Checkpoints by themselves: which one is the newest, what is refused before it is read."""

from __future__ import annotations

import json
import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax.files import file_sum
from iphyre_jax.train import trainer
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, manifest
from tests.robustness.failing_disk import FailingDisk

CONFIG = TrainConfig(games=("support", "hole"), hidden_sizes=(8,), learner=PPO(minibatches=2))


def saved(run: Path, update: int) -> Path:
    state = trainer.start(CONFIG)._replace(update=np.asarray(update, np.int32))
    return checkpoint.save(run, CONFIG, state)


@pytest.mark.slow
def test_checkpoints_are_sorted_as_numbers(tmp_path: Path) -> None:
    """From update 1,000,000 on the names are longer; the newest two stay all the same."""
    for update in (999_998, 999_999, 1_000_000):
        assert saved(tmp_path, update).is_dir()
    (tmp_path / checkpoint.FOLDER / "12 of mine").mkdir()  # no checkpoint
    assert checkpoint.names(tmp_path) == ["999999", "1000000"]
    assert int(checkpoint.load(tmp_path, CONFIG).update) == 1_000_000
    assert int(checkpoint.load(tmp_path, CONFIG, "999999").update) == 999_999
    with pytest.raises(FileNotFoundError, match="there is no checkpoint '12 of mine', only 999999, 1000000"):
        checkpoint.load(tmp_path, CONFIG, "12 of mine")


def test_a_half_removed_checkpoint_is_no_obstacle(tmp_path: Path) -> None:
    saved(tmp_path, 1)
    left = tmp_path / checkpoint.FOLDER / ".000001"
    left.mkdir()
    (left / "file").touch()
    checkpoint.remove(tmp_path, "000001")
    assert not any((tmp_path / checkpoint.FOLDER).iterdir())


def test_what_a_kill_left_is_removed_and_files_of_others_stay(tmp_path: Path) -> None:
    saved(tmp_path, 1)
    (tmp_path / checkpoint.FOLDER / ".DS_Store").touch()  # a file manager's
    (tmp_path / checkpoint.FOLDER / ".000001").mkdir()
    saved(tmp_path, 2)
    assert {entry.name for entry in (tmp_path / checkpoint.FOLDER).iterdir()} == {".DS_Store", "000001", "000002"}


def rewrite(path: Path, **changes: Any) -> None:
    """Change a manifest and make the sum fit, as whoever sends a hostile run folder would."""
    content = {**json.loads((path / manifest.MANIFEST).read_text()), **changes}
    (path / manifest.MANIFEST).write_text(json.dumps(content))
    (path / manifest.SUM).write_text(f"{file_sum(path / manifest.MANIFEST)}\n")


def test_a_manifest_that_fits_is_not_trusted_with_sizes(tmp_path: Path) -> None:
    """Each is refused in one line before the state is read: more bytes than the arrays have, a pipe, odd fields."""
    path = saved(tmp_path, 1)
    files = json.loads((path / manifest.MANIFEST).read_text())["files"]

    def refused(message: str) -> None:
        with pytest.raises(ValueError, match=message) as error:
            checkpoint.load(tmp_path, CONFIG, to_resume=True)
        assert "\n" not in str(error.value)
        assert str(path) in str(error.value)

    for changes, message in (
        ({"files": []}, "files: expected dict, got a list of 0"),
        ({"files": {**files, next(iter(files)): 7}}, "expected size and sha256, got 7"),
        ({"versions": None}, "versions: expected dict, got None"),
        ({"update": "1"}, "update: expected int"),
        ({"update": 2}, "expected the checkpoint of 1 updates, got that of 2"),
        ({"format": [[]]}, "expected format 3, got a list of 1"),
    ):
        rewrite(path, **{"files": files, "update": 1, "format": 3, "versions": {}, **changes})
        refused(message)
    bomb = path / manifest.STATE / "bomb"
    with bomb.open("wb") as file:
        file.truncate(2**40)  # a hole: it takes no room
    about = {"size": 2**40, "sha256": "0"}
    rewrite(path, files={**files, "state/bomb": about}, update=1, format=3)
    refused("the files of state/ are larger than the arrays of these settings")
    bomb.unlink()
    os.mkfifo(bomb)
    refused("state/bomb is no plain file")


def test_a_state_of_another_update_is_refused(tmp_path: Path) -> None:
    path = saved(tmp_path, 1)
    rewrite(path, update=2)
    path.rename(path.with_name("000002"))
    with pytest.raises(ValueError, match="its state is that of 1 updates"):
        checkpoint.load(tmp_path, CONFIG)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:coroutine .* was never awaited:RuntimeWarning")  # orbax's own, when it fails
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_save_that_fails_can_be_made_again(tmp_path: Path) -> None:
    """No thread waits: orbax's waited twenty minutes, and the process with them, for a folder that was never made."""
    saved(tmp_path, 1)
    before, disk = set(threading.enumerate()), FailingDisk()
    for k in range(8):
        with (
            disk.failing(tmp_path, k),
            pytest.raises(OSError, match="000002: the checkpoint cannot be written") as error,
        ):
            saved(tmp_path, 2)
        assert "\n" not in str(error.value)
        assert checkpoint.names(tmp_path) == ["000001"]
    deadline = time.monotonic() + 20
    # Those of metadata_store are idle; they end with the process.
    while waiting := [one.name for one in set(threading.enumerate()) - before if "metadata_store" not in one.name]:
        assert time.monotonic() < deadline, waiting
        time.sleep(0.05)
    assert saved(tmp_path, 2).is_dir()

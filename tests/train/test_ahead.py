"""What the evaluation needs is compiled beside the training, into the cache folder, by a process that ends with it."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path
from typing import Any, NoReturn

import pytest

from iphyre_jax.execution import configuration
from iphyre_jax.train import ahead
from iphyre_jax.train.settings.run import TrainConfig

CONFIG = TrainConfig(games=("support",))


def no_process(*_: object, **__: object) -> NoReturn:
    pytest.fail("a process was started")


def test_no_process_where_it_cannot_help(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", no_process)
    monkeypatch.setattr(ahead, "_all_cached", lambda *_: True)
    with ahead.compiled_ahead(CONFIG, ("hole",)):
        pass
    monkeypatch.setattr(ahead, "_all_cached", no_process)
    with ahead.compiled_ahead(CONFIG, ()):
        pass
    monkeypatch.setattr(configuration, "usable_cores", lambda: 1)
    with ahead.compiled_ahead(CONFIG, ("hole",)):
        pass


def test_one_that_cannot_be_started_is_done_without(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> NoReturn:
        raise OSError

    monkeypatch.setattr(subprocess, "Popen", refused)
    with ahead._process(CONFIG, ("hole",), Path("unused")):
        pass


@pytest.mark.slow
def test_a_process_compiles_and_ends_with_the_one_that_began_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def recorded(*args: Any, **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen(*args, **options))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", recorded)
    with ahead._process(CONFIG, ("support",), tmp_path):
        until = time.monotonic() + 240
        while not list(tmp_path.glob("*.program")) and time.monotonic() < until:
            assert started[0].poll() is None or list(tmp_path.glob("*.program")), "it ended before it had compiled"
            time.sleep(0.2)
        assert list(tmp_path.glob("*.program"))
    assert started[0].returncode is not None

"""Programs compiled anew: a process that knows none, with an empty folder of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation import executables

ANEW = {"folder", "compiled", "known"}  # fixtures of tests that compile, however often the suite has run


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what compiles anew, or starts a process for each case, as slow."""
    for item in items:
        if ANEW & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of programs, which this process uses; it has loaded none."""
    made = tmp_path / "programs"
    made.mkdir(mode=0o700)
    monkeypatch.setattr(executables, "_loaded", {})
    monkeypatch.setattr(configuration, "_settings", configuration._Settings(folder=made, folder_is_known=True))
    return made


@pytest.fixture
def compiled(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The list takes the description of each program that is compiled from now on."""
    del folder
    seen: list[Any] = []
    whole = executables.compile_all

    def compile_all(jobs: Any, show: Any) -> None:
        seen.extend(job.program for job in jobs)
        whole(jobs, show)

    monkeypatch.setattr(executables, "compile_all", compile_all)
    return seen

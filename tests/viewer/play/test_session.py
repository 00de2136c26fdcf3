"""Attempts: one counts once it is on disk, and one that cannot be saved is said to be lost."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from iphyre_jax import load_scene
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.session import Session
from iphyre_jax.viewer.plays import read_plays
from iphyre_jax.viewer.recording import Recording
from iphyre_jax.viewer.sheets import start_of


@pytest.fixture
def recording() -> Recording:
    return start_of(load_scene("hole"))


def test_an_attempt_that_cannot_be_saved_does_not_count(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = Session(tmp_path / "attempts.jsonl")
    session.add(recording)
    before = (tmp_path / "attempts.jsonl").read_bytes()

    def full(handle: int, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(RefusedError, match=r"not saved and does not count: No space left on device") as caught:
            session.add(recording)
    assert caught.value.status == 507
    assert (tmp_path / "attempts.jsonl").read_bytes() == before
    assert session.standing(recording.scene)["left"] == 4
    assert session.add(recording)["left"] == 3
    assert len(read_plays(tmp_path / "attempts.jsonl")) == 2


def test_a_session_opens_what_a_killed_one_left(tmp_path: Path, recording: Recording) -> None:
    file = tmp_path / "attempts.jsonl"
    Session(file).add(recording)
    with file.open("ab") as torn:
        torn.write(b'{"schema": "iphyre_jax/play", "version": 1, "agent": "y')
    with pytest.warns(RuntimeWarning, match="the last line was torn") as caught:
        session = Session(file)
    assert len(caught) == 1
    session.add(recording)
    assert len(read_plays(file)) == 2


def test_a_session_refuses_another_file(tmp_path: Path) -> None:
    (tmp_path / "attempts.jsonl").write_bytes(b"notes\n")
    with pytest.raises(ValueError, match="expected a file of plays, got something else"):
        Session(tmp_path / "attempts.jsonl")


def test_asking_about_scenes_keeps_none_of_them(recording: Recording) -> None:
    session = Session(None)
    for game in ("hole", "support", "fill"):
        session.begin_again(load_scene(game))
        session.standing(load_scene(game))
        session.attempts(load_scene(game))
    assert not session._series


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is made by the first attempt, and that would be late to learn of it."""
    monkeypatch.setattr(os, "access", lambda path, mode: path != tmp_path)  # root may write everywhere
    with pytest.raises(PermissionError, match=r"attempts.jsonl: expected a folder that can be written, and [^\n]*$"):
        Session(tmp_path / "attempts.jsonl")

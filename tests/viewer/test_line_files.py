"""Files of lines: an append is whole or not there, and a torn tail never touches the next line."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from iphyre_jax.viewer import line_files
from iphyre_jax.viewer.plays import MAX_LINE, append_play, open_plays, read_plays

LINE: dict[str, object] = {
    "schema": "iphyre_jax/play",
    "version": 1,
    "agent": "you",
    "scene": "hole",
    "plan": [-1, -1, 83, 32],
}


def numbered(number: int) -> dict[str, object]:
    return LINE | {"plan": [-1, -1, -1, number]}


def numbers(file: Path) -> list[int]:
    return [play.plan[3] for play in read_plays(file)]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    for number in (1, 2):
        append_play(tmp_path / "plays.jsonl", numbered(number))
    return tmp_path / "plays.jsonl"


def test_a_file_cut_at_any_byte_loses_only_what_was_cut(file: Path) -> None:
    whole = file.read_bytes()
    first = whole.index(b"\n") + 1
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        kept = [number for number, end in ((1, first - 1), (2, len(whole) - 1)) if length >= end]
        torn = length not in (0, first - 1, first, len(whole) - 1)
        if torn:
            with pytest.warns(RuntimeWarning, match="the last line was torn") as caught:
                open_plays(file)
            assert len(caught) == 1
            assert str(file) in str(caught[0].message)
        open_plays(file)  # without a warning: it is mended
        append_play(file, numbered(3))
        assert numbers(file) == [*kept, 3]


def test_an_append_mends_what_another_process_left(file: Path) -> None:
    with file.open("ab") as torn:
        torn.write(b'{"schema": "iphyre_jax/play", "ver')
    with pytest.warns(RuntimeWarning, match="the last line was torn, so its 34 bytes were cut"):
        append_play(file, numbered(3))
    assert numbers(file) == [1, 2, 3]


def test_readers_skip_a_torn_tail_and_leave_it(file: Path) -> None:
    content = file.read_bytes() + b'{"schema": "iphyre_jax/pl'
    file.write_bytes(content)
    with pytest.warns(RuntimeWarning, match=r"plays.jsonl: skipped 1 damaged line \(3\)"):
        assert numbers(file) == [1, 2]
    assert file.read_bytes() == content
    file.write_bytes(b'{"schema": "iphyre')
    with pytest.warns(RuntimeWarning, match="skipped 1 damaged line"):
        assert numbers(file) == []


@pytest.mark.parametrize("tail", [b"a note of mine", b"\0" * 300, b"x" * (3 * MAX_LINE)])
def test_a_tail_that_is_not_ours_is_never_cut(tail: bytes, file: Path) -> None:
    before = file.read_bytes() + tail
    file.write_bytes(before)
    open_plays(file)
    append_play(file, numbered(3))
    assert file.read_bytes().startswith(before + b"\n")
    with pytest.warns(RuntimeWarning, match=r"skipped 1 damaged line \(3\)"):
        assert numbers(file) == [1, 2, 3]


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EIO, errno.EDQUOT])
@pytest.mark.parametrize("written", [0, 1, 40])
def test_a_failed_write_leaves_the_file_as_it_was(
    error: int, written: int, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, write = file.read_bytes(), os.write
    room = [written]

    def full(handle: int, content: bytes) -> int:
        if not room[0]:
            raise OSError(error, os.strerror(error))
        count = write(handle, content[: room[0]])
        room[0] -= count
        return count

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match=os.strerror(error)):
            append_play(file, numbered(3))
    assert file.read_bytes() == before
    append_play(file, numbered(3))
    assert numbers(file) == [1, 2, 3]


def test_a_failed_flush_is_an_error_and_leaves_the_file_as_it_was(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = file.read_bytes()

    def fail(handle: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output error"):
        append_play(file, numbered(3))
    assert file.read_bytes() == before


def test_writes_in_small_parts_are_one_line(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, content: write(handle, content[:7]))
    append_play(file, numbered(3))
    assert numbers(file) == [1, 2, 3]


def test_a_line_that_nobody_could_read_is_not_written(file: Path) -> None:
    before = file.read_bytes()
    with pytest.raises(ValueError, match=f"plays.jsonl: expected a line of at most {MAX_LINE} bytes, got"):
        append_play(file, LINE | {"agent": "x" * MAX_LINE})
    assert file.read_bytes() == before


def test_a_file_that_somebody_holds_is_an_error_not_a_wait(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr(line_files, "LOCK_SECONDS", 0.1)
    with file.open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(OSError, match=r"plays\.jsonl: expected a free file, but another process writes it"):
            append_play(file, numbered(3))
    append_play(file, numbered(3))
    assert numbers(file) == [1, 2, 3]


WRITER = """
import sys
from pathlib import Path
from iphyre_jax.viewer import line_files
for number in range(100):
    line = b'{"schema": "iphyre_jax/play", "writer": %d, "number": %d, "x": "%s"}' % (
        int(sys.argv[2]), number, b"x" * 5000)
    line_files.append_line(Path(sys.argv[1]), line, b'{"schema"', lambda tail: False, 100_000)
"""


def test_two_processes_take_turns(tmp_path: Path) -> None:
    import json

    file = tmp_path / "lines.jsonl"
    writers = [subprocess.Popen([sys.executable, "-W", "error", "-c", WRITER, file, str(k)]) for k in (0, 1)]
    assert [writer.wait(60) for writer in writers] == [0, 0]
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    for writer in (0, 1):
        assert [line["number"] for line in lines if line["writer"] == writer] == list(range(100))

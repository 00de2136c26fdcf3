"""Entries of the cache: what is written is read, and whatever is not sound, or not one's own, is not."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from iphyre_jax.execution.compilation.cache_folder import (
    KEEP_DAYS,
    claimed,
    entry_path,
    machine_of,
    private_folder,
    read_entry,
    remove_old_entries,
    wait_for_claim,
    write_entry,
)

KEY = {"program": {"class": "a:b", "lanes": 3}, "jaxlib": "1.2"}
PAYLOAD = bytes(range(256)) * 40


@pytest.fixture
def entry(tmp_path: Path) -> Path:
    path = entry_path(private_folder(tmp_path / "programs"), KEY)
    write_entry(path, KEY, PAYLOAD)
    return path


def test_what_is_written_is_read(entry: Path) -> None:
    assert read_entry(entry, KEY) == PAYLOAD
    assert entry.stat().st_mode & 0o777 == 0o600
    assert [path.name for path in entry.parent.iterdir()] == [entry.name]
    assert entry_path(entry.parent, KEY | {"jaxlib": "1.3"}) != entry


@pytest.mark.parametrize("length", [0, 1, 19, 20, 60, 200, -1, -4000])
def test_a_cut_entry_is_none(entry: Path, length: int) -> None:
    entry.write_bytes(entry.read_bytes()[:length])
    assert read_entry(entry, KEY) is None


@pytest.mark.parametrize("place", [0, 25, 60, -1, -5000])
def test_a_changed_byte_makes_it_none(entry: Path, place: int) -> None:
    content = bytearray(entry.read_bytes())
    content[place] ^= 1
    entry.write_bytes(bytes(content))
    assert read_entry(entry, KEY) is None


def test_an_entry_under_another_ones_name_is_none(entry: Path) -> None:
    assert read_entry(entry, KEY | {"jaxlib": "1.3"}) is None


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_what_others_may_write_is_none(entry: Path, mode: int) -> None:
    entry.chmod(mode)
    assert read_entry(entry, KEY) is None


def test_what_another_user_owns_is_none(entry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert read_entry(entry, KEY) is None


def test_entries_that_nobody_reads_go(entry: Path) -> None:
    other = entry_path(entry.parent, KEY | {"jaxlib": "1.3"})
    write_entry(other, KEY, PAYLOAD)
    long_ago = time.time() - (KEEP_DAYS + 1) * 86_400
    os.utime(entry, (long_ago, long_ago))
    os.utime(other, (long_ago, long_ago))
    assert read_entry(entry, KEY) == PAYLOAD  # it is in use again
    others = [entry.parent / name for name in ("thesis.program", "notes.jax", f"a{other.name}")]  # not ours
    draft = entry.parent / f".{entry.stem}.0123abcd.part.program"
    for path in (*others, draft):
        path.touch()
        os.utime(path, (long_ago, long_ago))
    remove_old_entries(entry.parent)
    assert sorted(entry.parent.iterdir()) == sorted([entry, *others])


def test_a_folder_stays_where_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever folder the process goes to."""
    monkeypatch.chdir(tmp_path)
    folder = private_folder(Path("programs"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert folder == tmp_path / "programs"
    assert folder.is_dir()


FEATURES = "fpu sse2 avx2 avx512f"


def test_processors_with_other_features_have_other_entries() -> None:
    """So that a program with AVX-512 never runs on a machine without."""
    here = machine_of(f"processor : 0\nflags\t: {FEATURES}\nbugs : none")
    assert machine_of(f"processor : 7\nflags : {' '.join(reversed(FEATURES.split()))}\n") == here
    assert machine_of(f"flags : {FEATURES.removesuffix(' avx512f')}") != here
    assert machine_of("Features : fp asimd") != machine_of("Features : fp asimd sve")


CLAIM = """
import sys, time
from pathlib import Path
from iphyre_jax.execution.compilation.cache_folder import claimed, write_entry
path = Path(sys.argv[1])
with claimed(path) as is_mine:
    print(is_mine, flush=True)
    sys.stdin.readline()
"""


@pytest.mark.parametrize("end", ["goes on", "is killed"])
def test_one_process_makes_an_entry(entry: Path, end: str) -> None:
    """Another one waits until it is made, or until the first has died."""
    other = subprocess.Popen(
        [sys.executable, "-c", CLAIM, str(entry)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None
    assert other.stdin is not None
    assert other.stdout.readline() == "True\n"
    with claimed(entry) as is_mine:
        assert not is_mine
    shown: list[bool] = []
    assert not wait_for_claim(entry, time.monotonic() + 0.2, lambda: shown.append(True))
    assert shown
    waiting = threading.Thread(target=wait_for_claim, args=(entry, math.inf, lambda: None))
    waiting.start()
    time.sleep(0.2)
    assert waiting.is_alive()
    if end == "goes on":
        other.stdin.write("\n")
        other.stdin.flush()
    else:
        other.kill()
    waiting.join(30)
    assert not waiting.is_alive()
    other.communicate()
    with claimed(entry) as is_mine:
        assert is_mine
    assert [path.name for path in entry.parent.iterdir()] == [entry.name]

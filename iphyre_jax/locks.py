"""Locks of folders and files: one process at a time.

The system drops a lock when its process ends, however it ends. Where the file system knows no locks (some network ones)
or Python has none (Windows), nothing is kept out.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from iphyre_jax.checks import one_line

if sys.platform != "win32":
    import fcntl

LOCK: Final = ".lock"  # in a folder that is locked


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other processes that ask for the same lock out of a folder, by a file `.lock` in it.

    What a killed process leaves is taken over.

    Raises:
        BlockingIOError: another process holds it; one line that names the process and its machine.
        OSError: the file cannot be written.
    """
    with lock_file(folder / LOCK, f"{folder}: expected a folder"):
        yield


@contextmanager
def lock_file(path: Path, expected: str) -> Iterator[None]:
    """Do what `locked` does, by another file; `expected` begins the line that says that nobody may use it."""
    handle = _take_lock(path, expected)
    while handle is not None and not _still_there(path, handle):  # its holder has just ended and removed it
        os.close(handle)
        handle = _take_lock(path, expected)
    if handle is None:
        yield
        return
    try:
        with suppress(OSError):  # a full disk: the next one is refused without a name
            os.ftruncate(handle, 0)
            os.pwrite(handle, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def try_lock(handle: int) -> bool | None:
    """Lock an open file. Return whether nobody else holds it, or None where there are no locks."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None  # the disk knows no locks
    return True


def _take_lock(path: Path, expected: str) -> int | None:
    """Open and lock a file; None where there are no locks."""
    if sys.platform == "win32":
        return None
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    found = try_lock(handle)
    if found:
        return handle
    holder = one_line(os.pread(handle, 200, 0).decode(errors="replace")) or "another process"
    os.close(handle)
    if found is None:
        return None
    raise BlockingIOError(f"{expected} that nobody uses, but {holder} does")


def _still_there(path: Path, handle: int) -> bool:
    """Whether an open file is the one that has this name."""
    try:
        return os.fstat(handle).st_ino == path.stat().st_ino
    except FileNotFoundError:
        return False

"""Files of lines that lose nothing: a line is appended whole or not at all, and is on disk when that is said.

A process that was killed, or a disk that was full, may leave half a line at the end: a torn tail. The next append, or
the next opening, cuts it, because nobody was told that it was saved. Only what begins as one of our lines is ever cut;
a whole line that lacks its line break gets it, and any other tail stays and gets a line break too.

Appends of several processes take turns: each holds a lock of the file while it writes. Where files cannot be locked
(Windows, some network disks) only the threads of one process take turns.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Final

from iphyre_jax.checks import one_line
from iphyre_jax.locks import try_lock

LOCK_SECONDS: Final = 5.0  # s, so long an append waits for those of other processes
SHOWN: Final = 5  # numbers of damaged lines that a warning names
_LOCK_EVERY: Final = 0.02  # s

_threads = Lock()  # a lock of the system does not hold between threads everywhere


def read_lines(path: Path, most: int) -> Iterator[tuple[int, bytes | None]]:
    """Yield each line with its number, from 1 on: its bytes, or None if there are more than `most`.

    Memory holds one line at a time.

    Raises:
        OSError: the file cannot be read.
    """
    with path.open("rb") as file:
        number = 0
        while content := file.readline(most + 1):
            number += 1
            if len(content) <= most:
                yield number, content
                continue
            yield number, None
            while content and not content.endswith(b"\n"):
                content = file.readline(most + 1)


@dataclass
class Damage:
    """The damaged lines of a file: how many, the first numbers, and what is wrong with the first one."""

    count: int = 0
    numbers: list[int] = field(default_factory=list)
    first: ValueError | None = None

    def add(self, number: int, error: ValueError | None) -> None:
        """Count a line; error: None for a torn last line, which is no sign of another file."""
        self.count += 1
        self.first = self.first or error
        if len(self.numbers) < SHOWN:
            self.numbers.append(number)

    def describe(self) -> str:
        """Name the lines, in one line."""
        numbers = ", ".join(map(str, self.numbers)) + (" ..." if self.count > SHOWN else "")
        return f"skipped {self.count} damaged line{'s' if self.count > 1 else ''} ({numbers})"


def append_line(path: Path, content: bytes, begin: bytes, is_whole: Callable[[bytes], bool], most: int) -> None:
    """Append a line; it is on disk when this function returns. After an error the file is as long as before.

    Args:
        path: the file; it is made if it is missing.
        content: the line, without its line break.
        begin: how each line of such a file begins.
        is_whole: whether a last line without a line break is whole.
        most: bytes of the longest line, line break included.

    Raises:
        OSError: the file cannot be written, or other processes write all the time.
        ValueError: the line is too long; one line.
    """
    if len(content) + 1 > most:
        raise ValueError(f"{one_line(str(path))}: expected a line of at most {most} bytes, got {len(content) + 1}")
    with _locked(path, os.O_RDWR | os.O_CREAT) as file:
        is_new = os.fstat(file).st_size == 0
        _mend(file, path, begin, is_whole, most)
        _write(file, content + b"\n")
        if is_new:
            _sync_folder(path)


def mend_file(path: Path, begin: bytes, is_whole: Callable[[bytes], bool], most: int) -> None:
    """Cut a torn tail, if there is one, with a warning; arguments and errors are those of `append_line`."""
    with _locked(path, os.O_RDWR) as file:
        _mend(file, path, begin, is_whole, most)


@contextlib.contextmanager
def _locked(path: Path, flags: int) -> Iterator[int]:
    """Open a file for one writer at a time."""
    with _threads:
        file = os.open(path, flags | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0), 0o666)
        try:
            _lock(file, path)
            yield file
        finally:
            os.close(file)  # which ends the lock


def _lock(file: int, path: Path) -> None:
    """Wait for the lock of an open file, if there are locks."""
    end = time.monotonic() + LOCK_SECONDS
    while try_lock(file) is False:
        if time.monotonic() > end:
            raise OSError(f"{one_line(str(path))}: expected a free file, but another process writes it")
        time.sleep(_LOCK_EVERY)


def _mend(file: int, path: Path, begin: bytes, is_whole: Callable[[bytes], bool], most: int) -> None:
    """See that the file ends with a line break."""
    size = os.fstat(file).st_size
    start = max(0, size - most)
    os.lseek(file, start, os.SEEK_SET)
    end = _read(file, size - start)
    if not end or end.endswith(b"\n"):
        return
    tail = end[end.rfind(b"\n") + 1 :]
    is_line = len(tail) < len(end) or start == 0  # else it began before what was read
    if is_line and not is_whole(tail) and tail.startswith(begin[: len(tail)]):
        os.ftruncate(file, size - len(tail))
        os.fsync(file)
        text = f"the last line was torn, so its {len(tail)} bytes were cut; it was never confirmed"
        warnings.warn(f"{one_line(str(path))}: {text}", RuntimeWarning, stacklevel=2)
    else:
        _write(file, b"\n")


def _write(file: int, content: bytes) -> None:
    """Write at the end and wait for the disk; after an error, or an interrupt, the old length is back."""
    size = os.lseek(file, 0, os.SEEK_END)
    try:
        left = memoryview(content)
        while left:
            if not (count := os.write(file, left)):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            left = left[count:]
        os.fsync(file)
    except BaseException:
        with contextlib.suppress(OSError):  # what stays then is a torn tail, which the next append cuts
            os.ftruncate(file, size)
            os.fsync(file)
        raise


def _read(file: int, count: int) -> bytes:
    parts = []
    while count and (part := os.read(file, count)):
        parts.append(part)
        count -= len(part)
    return b"".join(parts)


def _sync_folder(path: Path) -> None:
    """Write the name of a new file to disk, where the system can."""
    with contextlib.suppress(OSError):
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

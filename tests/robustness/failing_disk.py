"""A disk on which writing fails: from the k-th write into a folder on, or where a file would grow too large."""

from __future__ import annotations

import errno
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


class FailingDisk:
    """Counts what Python does to the files of a folder, and refuses all of it from some point on.

    Counted are opening a file to write, making a folder, renaming and `os.fsync`. What compiled code writes by itself
    is not; `files_of_at_most` reaches it too.
    """

    def __init__(self) -> None:
        self._root = ""
        self._from: int | None = None
        self._code = errno.ENOSPC
        self.writes = 0
        self.failed = False  # since `failing` was entered
        self._fsync = os.fsync
        sys.addaudithook(self._on_event)  # cannot be taken away again; without a root it does nothing

    @contextmanager
    def failing(self, root: Path, from_write: int | None = None, code: int = errno.ENOSPC) -> Iterator[None]:
        """Let writes into `root` fail with an errno, from that one on, counted from 0; None to count only."""
        self._root, self._from, self._code, self.writes = str(root.absolute()), from_write, code, 0
        self.failed = False
        os.fsync = self._on_fsync
        try:
            yield
        finally:
            os.fsync = self._fsync
            self._root = ""

    def _on_event(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._root:
            return
        if event == "open" and isinstance(arguments[2], int) and not arguments[2] & WRITING:
            return
        if event in ("open", "os.mkdir", "os.rename") and isinstance(arguments[0], str | os.PathLike | bytes):
            path = os.fsdecode(arguments[1 if event == "os.rename" else 0])
            if str(Path(path).absolute()).startswith(self._root):
                self._write(path)

    def _on_fsync(self, handle: int) -> None:
        self._write()
        self._fsync(handle)

    def _write(self, *path: str) -> None:
        self.writes += 1
        if self._from is not None and self.writes > self._from:
            self.failed = True
            raise OSError(self._code, os.strerror(self._code), *path)


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Let every write of this process fail that would make a file longer, also in compiled code; short writes stay."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

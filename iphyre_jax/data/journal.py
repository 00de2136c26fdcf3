"""What a long collection has worked out so far, in a folder: after a kill the same call finds it there and goes on.

An entry's name is the SHA-256 of everything that it depends on, so a stale one is never read by mistake. An entry is
whole or is worked out again.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import show
from iphyre_jax.files import read_npz, replacing
from iphyre_jax.locks import locked
from iphyre_jax.provenance import CORE, versions

_ENTRY: Final = re.compile(r"[0-9a-f]{64}\.npz|\.[0-9a-f]{64}\.[0-9a-f]{8}\.part\.npz")  # or the draft of one
MAX_ENTRY: Final = 2**33  # bytes

Arrays = Mapping[str, npt.NDArray[Any]]
Report = Callable[[str], None]


def _silent(_: str) -> None:
    """Report nothing."""


@dataclass(frozen=True)
class Journal:
    """Results of calls, in a folder, or nowhere."""

    folder: Path | None = None
    report: Report = _silent
    """Called with a line of progress now and then."""

    def entry(self, settings: Mapping[str, Any], inputs: Arrays, work: Callable[[], Arrays]) -> Arrays:
        """Return what `work` returns, from the folder if it is there.

        Args:
            settings: JSON values that the result depends on.
            inputs: arrays that it depends on.
            work: works it out.

        Raises:
            OSError: an entry cannot be written.
        """
        if self.folder is None:
            return work()
        path = self.folder / f"{_sum_of(settings, inputs)}.npz"
        if path.exists():
            try:
                return read_npz(path, MAX_ENTRY)
            except ValueError:  # damaged: work it out again
                pass
        arrays = work()
        with replacing(path) as draft, draft.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        return arrays


def _sum_of(settings: Mapping[str, Any], inputs: Arrays) -> str:
    described = {name: [str(array.dtype), list(array.shape)] for name, array in inputs.items()}
    text = json.dumps([versions(CORE), settings, described], sort_keys=True)
    total = hashlib.sha256(text.encode())
    for _, array in sorted(inputs.items()):
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()


@contextmanager
def journal_in(folder: str | os.PathLike[str] | None, report: Report | None = None) -> Iterator[Journal]:
    """Open a journal for one process at a time; its entries go when the work is done, and stay after an error.

    Other files of the folder stay. The folder goes if it is empty then.

    Raises:
        ValueError: it is no path; one line.
        BlockingIOError: another process works here; one line.
        OSError: the folder cannot be made.
    """
    if folder is None:
        yield Journal(None, report or _silent)
        return
    if not isinstance(folder, str | os.PathLike) or "\0" in str(folder):
        raise ValueError(f"journal: expected the path of a folder, got {show(folder)}")
    path = Path(folder)
    path.mkdir(parents=True, exist_ok=True)
    with locked(path):
        yield Journal(path, report or _silent)
        with suppress(OSError):
            for file in path.iterdir():
                if _ENTRY.fullmatch(file.name):
                    file.unlink(missing_ok=True)
    with suppress(OSError):
        path.rmdir()

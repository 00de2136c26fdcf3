"""Memory: what a call will take is worked out before it asks for it, and refused if too little is free."""

from __future__ import annotations

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

import jax

UNKNOWN: Final = 16 * 10**9  # bytes; taken for free where the system does not say
_UNLIMITED: Final = 2**62  # bytes
_ALWAYS: Final = 64 * 10**6  # bytes; a call that takes less is not worth the question
_CONTROL_GROUP: Final = Path("/sys/fs/cgroup")


def check_memory(name: str, needed: float, remedy: str) -> None:
    """Refuse a call that would take more memory than is free.

    Args:
        name: of the argument that decides the size, for the message.
        needed: bytes that the call will take, its results included.
        remedy: what to do instead, for the message.

    Raises:
        ValueError: less is free; one line with both figures and the remedy.
    """
    if needed > _ALWAYS and needed > (free := available()):
        figures = f"expected a call of at most {_gigabytes(free)}, the memory that is free, got {_gigabytes(needed)}"
        raise ValueError(f"{name}: {figures}; {remedy}")


def check_start(needed: float) -> None:
    """Refuse to start JAX where `ulimit -v` leaves too little: its libraries would abort the process without a line.

    Args:
        needed: bytes of address space.

    Raises:
        MemoryError: less is left; one line with both figures.
    """
    if needed > (left := _of_process()):
        figures = f"expected {_gigabytes(needed)} of address space for JAX to start, got {_gigabytes(max(0, left))}"
        raise MemoryError(f"ulimit -v: {figures}; allow at least 2 GB, and more on a machine of many cores")


def available() -> int:
    """Return the bytes that this process may still take: of the machine, its control group and its own limit."""
    return max(0, min(_of_machine(), _of_control_group(), _of_process()))


def _of_machine() -> int:
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            return 1024 * int(line.split()[1])
    return UNKNOWN


def _of_control_group() -> int:
    """Return what a container has left; caches of files count as used, of which the kernel frees some."""
    most, used = (_lines(_CONTROL_GROUP / f"memory.{name}") for name in ("max", "current"))
    inactive = [line.split()[1] for line in _lines(_CONTROL_GROUP / "memory.stat") if line.startswith("inactive_file ")]
    if not most or not used or not most[0].isdigit():
        return _UNLIMITED
    return int(most[0]) - int(used[0]) + sum(map(int, inactive))


def _of_process() -> int:
    """Return what `ulimit -v` leaves."""
    try:
        import resource
    except ModuleNotFoundError:  # not on Windows
        return _UNLIMITED
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    pages = _lines(Path("/proc/self/statm"))
    if limit == resource.RLIM_INFINITY or not pages:
        return _UNLIMITED
    return limit - int(pages[0].split()[0]) * os.sysconf("SC_PAGE_SIZE")


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.3g} GB" if size < 1e15 else f"{size:.1e} bytes"


def forget_programs() -> None:
    """Free the programs that JAX has compiled in this process, between two runs that share none, and their memory.

    Linux lets a process map 65,530 pieces of memory, and each program takes some. Beyond that LLVM crashes.
    """
    jax.clear_caches()
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):  # no C library of GNU's, which would keep what is freed
        ctypes.CDLL(None).malloc_trim(0)

"""What is checked before the package is used: that this is no forked child, and that JAX has room to start.

Threads and clients do not come along into a forked child, so one forked after use would wait for them forever.
Processes of our own are therefore started anew (`own_process`).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Final

from iphyre_jax.execution.configuration import jax_has_started
from iphyre_jax.memory import check_start

START_BYTES: Final = 1.1e9  # of address space that JAX and our client take, measured with 1 and 2 cores


@dataclass
class _Use:
    """The process that has used this package."""

    pid: int | None = None


_use = _Use()


def check_fork() -> None:
    """Note that this process uses the package; call it first wherever threads, locks, JAX or a client are used.

    A child that never calls it, as one that only starts another program, is unaffected.

    Raises:
        RuntimeError: the process was forked from one that had used the package; one line.
        MemoryError: JAX has not started, and `ulimit -v` leaves it too little; one line.
    """
    pid = os.getpid()
    if _use.pid is None:
        if not jax_has_started():
            check_start(START_BYTES)
        _use.pid = pid
    elif _use.pid != pid:
        raise RuntimeError(
            "iphyre_jax: this process was forked from one that had already used it, and its threads did not come "
            'along; start processes by spawn, as multiprocessing.get_context("spawn") does'
        )

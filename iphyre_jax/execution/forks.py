"""Forked children: threads and clients do not come along, so a child forked after use would wait for them forever."""

from __future__ import annotations

import os
from dataclasses import dataclass


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
    """
    pid = os.getpid()
    if _use.pid is None:
        _use.pid = pid
    elif _use.pid != pid:
        raise RuntimeError(
            "iphyre_jax: this process was forked from one that had already used it, and its threads did not come "
            'along; start processes by spawn, as multiprocessing.get_context("spawn") does'
        )

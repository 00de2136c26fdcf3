"""Work on all cores: the calling thread, and helpers from one pool."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from itertools import count
from threading import Event
from typing import TypeVar

from iphyre_jax.execution import configuration

Item = TypeVar("Item")
Result = TypeVar("Result")


@cache
def _helpers(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="iphyre_jax")


def run_all(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run `work` on all items and return the results in order.

    The configured number of helpers take items, and so does the calling thread, because a helper takes time to wake. So
    there is one thread more than there are cores, and no core waits while a group of worlds is packed or collected. An
    error or an interrupt is raised when the running items have ended; the others are dropped.
    """
    given = list(items)
    results: dict[int, Result] = {}
    numbers, stop = count(), Event()

    def take() -> None:
        while not stop.is_set() and (k := next(numbers)) < len(given):
            try:
                results[k] = work(given[k])
            except BaseException:
                stop.set()
                raise

    threads = configuration.threads()
    helpers = [_helpers(threads).submit(take) for _ in range(min(threads, len(given) - 1))]
    try:
        take()
    finally:
        started = [helper for helper in helpers if not helper.cancel()]
        try:
            wait(started)
        finally:
            stop.set()  # an interrupt of the wait ends the others too
    for helper in started:
        helper.result()
    return [results[k] for k in range(len(given))]

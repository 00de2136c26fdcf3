"""Work on all cores: the calling thread, and helpers from one pool."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from itertools import count
from threading import Event
from typing import TypeVar

from iphyre_jax.execution import configuration
from iphyre_jax.execution.forks import check_fork

Item = TypeVar("Item")
Result = TypeVar("Result")


@cache
def _helpers(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="iphyre_jax")


def most_helpers() -> int:
    """Return how many helpers work beside the calling thread.

    Where all cores play there is one thread more, so that no core waits while a group of worlds is packed or collected.
    Where `configure` leaves cores to others, that thread would take one of them.
    """
    threads = configuration.threads()
    return threads if threads >= configuration.usable_cores() else threads - 1


def run_all(work: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Run `work` on all items and return the results in order.

    Helpers take items, and so does the calling thread, because a helper takes time to wake. An error or an interrupt is
    raised when the running items have ended; the others are dropped.
    """
    check_fork()
    given = list(items)
    results: dict[int, Result] = {}
    numbers, stop = count(), Event()

    def take() -> None:
        try:
            while not stop.is_set() and (k := next(numbers)) < len(given):
                results[k] = work(given[k])
        except BaseException:  # an interrupt may come between two items too
            stop.set()
            raise

    most = most_helpers()
    helpers: list[Future[None]] = []
    try:
        for _ in range(min(most, len(given) - 1)):
            helpers.append(_helpers(most).submit(take))
        take()
    except BaseException:
        stop.set()
        raise
    finally:
        started = [helper for helper in helpers if not helper.cancel()]
        _wait(started, stop)
    for helper in started:
        helper.result()
    return [results[k] for k in range(len(given))]


def _wait(helpers: Sequence[Future[None]], stop: Event) -> None:
    """Wait until helpers have ended; an interrupt drops their further items, and is raised when they have ended.

    Nobody may go on before, because helpers write into arrays that may belong to the caller's program.
    """
    interrupt: BaseException | None = None
    while True:
        try:
            wait(helpers)
            break
        except BaseException as error:
            stop.set()
            interrupt = error
    if interrupt is not None:
        raise interrupt

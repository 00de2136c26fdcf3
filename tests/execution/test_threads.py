"""Work on all cores: order, errors, what is dropped, and calls within calls."""

from __future__ import annotations

import threading
import time
from concurrent.futures import wait
from itertools import count
from typing import Any

import pytest

from iphyre_jax.execution import configuration, threads
from iphyre_jax.execution.threads import run_all


def test_results_are_in_order() -> None:
    def work(k: int) -> int:
        time.sleep(0.01 * (k % 3))
        return k * k

    assert run_all(work, range(20)) == [k * k for k in range(20)]
    assert run_all(work, []) == []


@pytest.mark.parametrize("error", [ValueError("three"), KeyboardInterrupt()])
def test_an_error_drops_what_has_not_begun(error: BaseException) -> None:
    begun = []
    lock = threading.Lock()

    def work(k: int) -> int:
        with lock:
            begun.append(k)
        if k == 3:
            raise error
        time.sleep(0.02)
        return k

    with pytest.raises(type(error)):
        run_all(work, range(1000))
    assert 3 in begun
    assert len(begun) < 20
    assert run_all(lambda k: k, range(5)) == list(range(5))  # nothing is left over


def test_an_interrupt_between_two_items_drops_what_has_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal is handled at any instruction of the main thread, not only inside an item."""
    main, begun = threading.current_thread(), []

    class Numbers:
        def __init__(self) -> None:
            self.numbers = count()

        def __next__(self) -> int:
            if threading.current_thread() is main and len(begun) > 4:
                raise KeyboardInterrupt
            return next(self.numbers)

    def work(k: int) -> None:
        begun.append(k)
        time.sleep(0.01)

    monkeypatch.setattr(threads, "count", Numbers)
    with pytest.raises(KeyboardInterrupt):
        run_all(work, range(500))
    assert len(begun) < 50


@pytest.mark.slow
def test_an_interrupt_of_the_wait_is_raised_when_the_running_items_have_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """They may write into arrays of a program that ends with the call."""
    main, begun, ended = threading.current_thread(), [], []
    interrupts = [KeyboardInterrupt(), KeyboardInterrupt()]

    def waits(helpers: Any) -> Any:
        if interrupts:
            raise interrupts.pop()
        return wait(helpers)

    def work(k: int) -> None:
        begun.append(k)
        time.sleep(0.01 if threading.current_thread() is main else 0.3)
        ended.append(k)

    monkeypatch.setattr(threads, "wait", waits)
    with pytest.raises(KeyboardInterrupt):
        run_all(work, range(200))
    assert sorted(begun) == sorted(ended)


def test_calls_within_calls_end() -> None:
    """Every helper may be waiting for helpers: whoever asks works too."""
    assert run_all(lambda k: sum(run_all(lambda j: j * k, range(10))), range(10)) == [45 * k for k in range(10)]


@pytest.mark.parametrize(("devices", "cores", "most"), [(1, 4, 1), (3, 4, 3), (4, 4, 5), (1, 1, 2), (None, 2, 3)])
def test_as_many_threads_play_as_there_are_devices_and_one_more_on_all_cores(
    monkeypatch: pytest.MonkeyPatch, devices: int | None, cores: int, most: int
) -> None:
    monkeypatch.setattr(configuration._settings, "threads", devices)
    monkeypatch.setattr(configuration, "usable_cores", lambda: cores)
    together = threading.Barrier(most)

    def work(_: int) -> int:
        together.wait(timeout=60)
        time.sleep(0.02)  # time for one thread too many to begin
        return threading.get_ident()

    assert len(set(run_all(work, range(4 * most)))) == most

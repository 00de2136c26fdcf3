"""Work on all cores: order, errors, what is dropped, and calls within calls."""

from __future__ import annotations

import threading
import time

import pytest

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


def test_calls_within_calls_end() -> None:
    """Every helper may be waiting for helpers: whoever asks works too."""
    assert run_all(lambda k: sum(run_all(lambda j: j * k, range(10))), range(10)) == [45 * k for k in range(10)]

"""Every public argument has a range: whatever lies outside is refused in one line that names it, at once."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest

from tests.robustness.bad_arguments.kinds import Case, complaint
from tests.robustness.bad_arguments.table import cases

PATIENCE = 60  # s; a call that is refused takes milliseconds
CASES = cases()
CALLS = sorted({case.call for case in CASES})


@pytest.fixture(autouse=True)
def _no_case_hangs() -> Iterator[None]:
    def give_up(*_: object) -> None:
        raise AssertionError("a bad argument was played instead of refused")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(PATIENCE)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("call", CALLS)
def test_bad_arguments_are_refused_in_one_line(call: str) -> None:
    assert [wrong for case in CASES if case.call == call if (wrong := complaint(case))] == []


def test_the_table_is_large_and_its_judge_not_blind() -> None:
    assert len(CASES) >= 300

    def broken(value: object) -> None:
        raise ValueError(f"two\nlines about {value}")

    for run in (broken, str, {}.__getitem__, lambda v: float("x")):
        assert complaint(Case("call", "argument", 3, run))

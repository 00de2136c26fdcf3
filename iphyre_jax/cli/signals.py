"""SIGTERM and SIGHUP interrupt a command as Ctrl-C does, so that what it has made is saved."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console

from iphyre_jax.cli.main import INTERRUPTED
from iphyre_jax.execution import interrupts
from iphyre_jax.train.reports.printing import say


@contextmanager
def interrupting() -> Iterator[list[int]]:
    """Let SIGTERM, which schedulers and containers send, and SIGHUP raise KeyboardInterrupt.

    Yields:
        The signals that came. All but the first do nothing. A signal that the process ignores (as after `nohup`) or
        handles otherwise stays as it is.
    """
    came: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        came.append(number)
        if len(came) == 1:
            raise KeyboardInterrupt

    there = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # not on Windows
    main = threading.current_thread() is threading.main_thread()
    default = [number for number in there if main and signal.getsignal(number) is signal.SIG_DFL]
    for number in default:
        signal.signal(number, interrupt)
    try:
        with interrupts.also(default):
            yield came
    finally:
        for number in default:
            signal.signal(number, signal.SIG_DFL)


def exit_code(number: int) -> int:
    """The exit code of a process that ended because of a signal, as shells count it: 143 for SIGTERM."""
    return 128 + number


def until_signal(work: Callable[[], int | None]) -> int:
    """Do a piece of work and return its exit code, or that of Ctrl-C or a signal; drafts of files are removed."""
    with interrupting() as signals:
        try:
            return work() or 0
        except KeyboardInterrupt:
            return exit_code(signals[0]) if signals else INTERRUPTED


def resumable(work: Callable[[], int | None], console: Console, last: str = "checkpoint") -> int:
    """Do what the same command continues from its last checkpoint; if it is interrupted, say so. Returns as above."""

    def told() -> int | None:
        try:
            return work()
        except KeyboardInterrupt:
            say(console, f"Interrupted; the same command goes on from the last {last}.")
            raise

    return until_signal(told)


def with_status(work: Callable[[Callable[[str], None]], int], console: Console) -> int:
    """Do what reports its progress, a line of text at a time. Returns as above."""

    def shown() -> int:
        with console.status("starting") as status:
            return work(lambda text: status.update(text))

    return until_signal(shown)

"""Ctrl-C while the main thread waits inside a compiled program that calls the host.

Python handles a signal in the main thread, between two of its instructions. A thread that waits for a program of JAX
makes none, so an interrupt would be seen when the program has ended, after minutes perhaps. But such a program calls
the host again and again, mostly in another thread, and the host can end it: an error in a callback ends the program.

Python writes the number of each signal to a file of our own (`signal.set_wakeup_fd`), unless somebody else, such as an
event loop, has set one. A thread reads it. An interrupt counts only while the main thread stands where the signal found
it, and if Ctrl-C means KeyboardInterrupt: whoever handles it in his own way is left alone. Whether the main thread goes
on tells a call that Python makes in it, between two of its instructions. To look where it stands would not do: a short
loop is met in the same place every second time.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import Final

import jax

LOOK_EVERY: Final = 0.02  # s between two looks at the main thread
UNSEEN: Final = 0.1  # s; the main thread has handled a signal by then, unless it waits in a program
LOOKS: Final = 10

_Place = tuple[int, int]  # a frame, and the instruction in it


@dataclass
class _State:
    """What this process watches, and the interrupt that nobody has handled yet."""

    sender: socket.socket | None = None
    reader: threading.Thread | None = None
    calls: int = 0  # that the main thread has made for `_stays`
    others: set[int] = field(default_factory=set)  # signals that count as interrupts besides Ctrl-C
    place: _Place | None = None  # where the main thread stands, with an interrupt that it cannot handle


_state = _State()


def watch() -> None:
    """Watch for interrupts from now on; call it before a program with callbacks runs. Only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        return
    if _state.sender is None:
        receiver, _state.sender = socket.socketpair()
        _state.sender.setblocking(False)
        _state.reader = threading.Thread(target=_read, args=(receiver,), name="iphyre_jax_interrupts", daemon=True)
        _state.reader.start()
    own = _state.sender.fileno()
    before = signal.set_wakeup_fd(own, warn_on_full_buffer=False)
    if before not in (-1, own):
        signal.set_wakeup_fd(before)


def check() -> None:
    """Raise KeyboardInterrupt if the main thread has been interrupted and cannot see it; for callbacks, any thread.

    Whose program calls is not known. So all are ended until the main thread goes on: to end the first alone could be to
    end that of another thread.
    """
    place = _state.place
    if place is not None and place == _main_place():
        raise KeyboardInterrupt("Ctrl-C while a program called the host")


@contextlib.contextmanager
def as_interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt in place of the error that JAX makes of an interrupt in a callback."""
    try:
        yield
    except jax.errors.JaxRuntimeError as error:
        if "KeyboardInterrupt" in str(error):
            raise KeyboardInterrupt from error
        raise


@contextlib.contextmanager
def also(numbers: Collection[int]) -> Iterator[None]:
    """Let other signals, whose handlers raise KeyboardInterrupt, end a program that calls the host as Ctrl-C does."""
    _state.others.update(numbers)
    try:
        yield
    finally:
        _state.others.difference_update(numbers)


def _read(receiver: socket.socket) -> None:
    """Look after each interrupt whether the main thread handles it; ends when the sender is closed."""
    with receiver:
        while numbers := receiver.recv(64):
            own = signal.SIGINT in numbers and signal.getsignal(signal.SIGINT) is signal.default_int_handler
            if not own and _state.others.isdisjoint(numbers):
                continue
            place = _main_place()
            if place is not None and _stays(place):
                _state.place = place
                while _state.place is not None and place == _main_place():
                    time.sleep(LOOK_EVERY)
                _state.place = None


def _count(_: object) -> int:
    _state.calls += 1
    return 0


_counting: Final = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p)(_count)


def _stays(place: _Place) -> bool:
    """Whether the main thread makes no instruction within UNSEEN s."""
    before = _state.calls
    ctypes.pythonapi.Py_AddPendingCall(_counting, None)  # if the queue is full, nobody empties it
    for _ in range(LOOKS):
        time.sleep(UNSEEN / LOOKS)
        if _state.calls != before or _main_place() != place:
            return False
    return True


def _main_place() -> _Place | None:
    """Return where the main thread stands; None outside Python code, as at a prompt."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)
    return None if frame is None else (id(frame), frame.f_lasti)


def _forget() -> None:
    """Watch no more; in a forked child, the parent does."""
    if _state.sender is not None:
        with contextlib.suppress(ValueError):  # forked in another thread: the file stays in use
            if (current := signal.set_wakeup_fd(-1)) not in (-1, _state.sender.fileno()):
                signal.set_wakeup_fd(current)
            _state.sender.close()
        _state.sender, _state.place = None, None


@atexit.register
def _end() -> None:
    """Close both ends, so that Python has nothing to warn of when it ends."""
    _forget()
    if _state.reader is not None:
        _state.reader.join(UNSEEN)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)

"""Where connections wait until their headers are there: one thread for all of them, so that a slow one costs nothing.

A place of the server is for those who know the token. Before that is known, a connection has a small buffer and little
time, and if too many wait, the one that has waited longest is closed: a browser sends its headers at once.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

WAITING: Final = 256  # connections without headers
MAX_HEADERS: Final = 16 * 1024  # bytes; a browser sends about 1 kB
END: Final = (b"\n\r\n", b"\n\n")  # of the headers, for Python's parser

Client = tuple[str, int] | str
Admit = Callable[[socket.socket, Client, bytes, float], None]
"""Takes over a connection with its client, what it has sent, and the end of its time; it must not block."""


@dataclass
class Waiting:
    """A connection without all of its headers."""

    connection: socket.socket
    client: Client
    end: float  # monotonic s
    sent: bytearray = field(default_factory=bytearray)


class Reception:
    """Waits for the headers of connections.

    Args:
        admit: takes over a connection whose headers are there, or are too long.
        seconds: s, that headers may take.
    """

    def __init__(self, admit: Admit, seconds: float) -> None:
        self._admit, self._seconds = admit, seconds
        self._new: deque[Waiting] = deque()
        self._waiting: dict[int, Waiting] = {}  # by number of the connection, the oldest first
        self._selector = selectors.DefaultSelector()
        self._bell, self._listener = socket.socketpair()
        self._bell.setblocking(False)
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="iphyre_jax_reception", daemon=True)
        self._thread.start()

    def take(self, connection: socket.socket, client: Client) -> None:
        """Wait for the headers of a connection."""
        self._new.append(Waiting(connection, client, time.monotonic() + self._seconds))
        self._ring()

    def close(self) -> None:
        """Close all connections that wait."""
        self._closed = True
        self._ring()
        self._thread.join()

    def _ring(self) -> None:
        with contextlib.suppress(BlockingIOError):  # it is ringing
            self._bell.send(b"!")

    def _run(self) -> None:
        while not self._closed:
            oldest = next(iter(self._waiting.values()), None)
            ready = self._selector.select(max(0.0, oldest.end - time.monotonic()) if oldest else None)
            for key, _ in ready:
                if key.fileobj is self._listener:
                    self._listener.recv(4096)
                elif entry := self._waiting.get(key.fd):
                    self._read(entry)
            self._end_late()
            while self._new:
                self._begin(self._new.popleft())
        for entry in [*self._waiting.values(), *self._new]:
            entry.connection.close()
        self._selector.close()
        self._bell.close()
        self._listener.close()

    def _begin(self, entry: Waiting) -> None:
        while len(self._waiting) >= WAITING:
            self._forget(next(iter(self._waiting.values()))).connection.close()
        try:
            entry.connection.setblocking(False)
            self._selector.register(entry.connection, selectors.EVENT_READ)
        except (OSError, ValueError):
            entry.connection.close()
            return
        self._waiting[entry.connection.fileno()] = entry

    def _read(self, entry: Waiting) -> None:
        try:
            part = entry.connection.recv(MAX_HEADERS)
        except BlockingIOError:
            return
        except OSError:
            part = b""
        if not part:
            self._forget(entry).connection.close()
            return
        entry.sent += part
        if any(end in entry.sent for end in END) or len(entry.sent) > MAX_HEADERS:
            self._forget(entry)
            self._admit(entry.connection, entry.client, bytes(entry.sent), entry.end)

    def _end_late(self) -> None:
        now = time.monotonic()
        while (oldest := next(iter(self._waiting.values()), None)) and oldest.end <= now:
            self._forget(oldest).connection.close()

    def _forget(self, entry: Waiting) -> Waiting:
        del self._waiting[entry.connection.fileno()]
        self._selector.unregister(entry.connection)
        return entry

"""A small HTTP server for one person on this machine, built on the standard library.

Each connection carries one request and has a deadline. It waits in the `Reception` until its headers are there; only
who knows the token then takes one of the places. So neither slow nor many clients can block the server. No part of a
request ever becomes the path of a file.
"""

from __future__ import annotations

import contextlib
import io
import json
import socket
import sys
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from threading import BoundedSemaphore, Thread
from typing import TYPE_CHECKING, Final, cast

from iphyre_jax.viewer.page import page_file
from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.guard import MAX_REQUEST, Guard, RefusedError
from iphyre_jax.viewer.play.reception import END, MAX_HEADERS, Client, Reception

if TYPE_CHECKING:
    from typing_extensions import Buffer

Request = socket.socket | tuple[bytes, socket.socket]  # the type in the standard library; here it is always a socket

CONNECTIONS: Final = 32  # requests with the token at once; a page needs about ten while it loads
STRANGERS: Final = 8  # refusals at once; each takes less than a millisecond
REQUEST_SECONDS: Final = 10.0  # s, for a request to arrive, and again for the answer to be sent

_CONTENT_TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
SCRIPTS: Final = (
    *("tape.js", "stage.js", "clock.js", "deck.js", "client.js", "game.js", "attempts.js"),
    *("check.js", "editor.js", "drawing.js", "play.js"),
)
FILES: Final = (*SCRIPTS, "style.css")
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",  # the address contains the token
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class PlayServer(HTTPServer):
    """Serves the play page on 127.0.0.1.

    Args:
        api: answers the calls of the page.
        token: the first part of every path.
        port: 0 for any free port.
        seconds: s, how long a request may take to arrive.
    """

    request_queue_size = 64

    def __init__(self, api: Api, token: str, port: int = 0, seconds: float = REQUEST_SECONDS) -> None:
        self.api, self.seconds = api, seconds
        self._places, self._strangers = BoundedSemaphore(CONNECTIONS), BoundedSemaphore(STRANGERS)
        self._reception = Reception(self._admit, seconds)  # first: a port that is taken closes the server
        super().__init__(("127.0.0.1", port), BaseHTTPRequestHandler)  # `_serve` makes the handlers
        self.guard = Guard(token, self.server_port)

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.guard.token}/"

    def process_request(self, request: Request, client_address: Client) -> None:
        """Let a new connection wait for its headers."""
        self._reception.take(cast(socket.socket, request), client_address)

    def _admit(self, connection: socket.socket, client: Client, sent: bytes, end: float) -> None:
        """Hand a connection whose headers are there to a thread, if there is a place for it."""
        if len(sent) > MAX_HEADERS and not any(mark in sent[:MAX_HEADERS] for mark in END):
            self._turn_away(connection, 431, "the headers are too long")
            return
        words = sent.split(b"\n", 1)[0].split()
        known = len(words) > 1 and self.guard.knows(words[1].decode("latin-1"))
        places = self._places if known else self._strangers
        if not places.acquire(blocking=False):
            self._turn_away(connection, 503, "too many requests at once; try again")
            return
        stream = io.BufferedReader(_RequestStream(connection, sent, end))
        try:
            Thread(target=self._serve, args=(connection, client, stream, places), daemon=True).start()
        except RuntimeError:  # the system has no thread left
            places.release()
            self._turn_away(connection, 503, "too many requests at once; try again")

    def _serve(
        self, connection: socket.socket, client: Client, stream: io.BufferedReader, place: BoundedSemaphore
    ) -> None:
        """Serve one connection, whose headers have been read."""
        try:
            connection.setblocking(True)
            _Handler(connection, client, self, stream)
        except Exception:
            self.handle_error(connection, client)
        finally:
            self.shutdown_request(connection)
            place.release()

    def _turn_away(self, connection: socket.socket, status: int, reason: str) -> None:
        """Refuse a connection without a thread."""
        content = json.dumps({"error": reason}).encode()
        head = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\nContent-Type: application/json\r\n"
        with contextlib.suppress(OSError):
            connection.send(f"{head}Content-Length: {len(content)}\r\nConnection: close\r\n\r\n".encode() + content)
        self.shutdown_request(connection)

    def server_close(self) -> None:
        """Close the server and all connections that wait."""
        super().server_close()
        self._reception.close()

    def handle_error(self, request: Request, client_address: Client) -> None:
        """Print an error in one line. Clients that are slow or close the connection are no errors."""
        error = sys.exception()
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"iphyre-jax play: {type(error).__name__}: {error}", file=sys.stderr)


class _RequestStream(io.RawIOBase):
    """Give what was read already, then read from a socket until a deadline and up to a largest size."""

    def __init__(self, connection: socket.socket, sent: bytes, end: float) -> None:
        self._connection, self._sent, self._end, self._bytes_left = connection, sent, end, MAX_REQUEST - len(sent)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Buffer) -> int:
        room = memoryview(buffer)
        if self._sent:
            part, self._sent = self._sent[: len(room)], self._sent[len(room) :]
            room[: len(part)] = part
            return len(part)
        left = self._end - time.monotonic()
        if left <= 0:
            raise TimeoutError("the request took too long")
        self._connection.settimeout(left)
        count = self._connection.recv_into(room[: self._bytes_left])
        self._bytes_left -= count
        return count


class _Handler(BaseHTTPRequestHandler):
    """Handles one request, whose headers have been read."""

    server: PlayServer
    server_version, sys_version = "iphyre-jax", ""

    def __init__(
        self, connection: socket.socket, client: Client, server: PlayServer, stream: io.BufferedReader
    ) -> None:
        self._stream = stream
        super().__init__(connection, client, server)

    def setup(self) -> None:
        """Let the parser read what the reception has read, then from the socket until the deadline."""
        super().setup()
        self.rfile.close()
        self.rfile = self._stream

    def do_GET(self) -> None:
        """Answer GET: send the page or one of its files."""
        try:
            name = self.server.guard.resource_name(self.path, self.headers) or "play.html"
            if name != "play.html" and name not in FILES:
                raise RefusedError(404, "no such file")
            self._send(200, _CONTENT_TYPES[name.rpartition(".")[2]], page_file(name).encode())
        except RefusedError as refusal:
            self._refuse(refusal)

    def do_POST(self) -> None:
        """Answer POST: run a call of the page."""
        guard = self.server.guard
        try:
            name = guard.resource_name(self.path, self.headers)
            length = guard.body_length(self.headers)
            body = self.rfile.read(length)
            if len(body) != length:
                raise RefusedError(400, "the body is shorter than stated")
            self._answer(self.server.api.call(name, body))
        except RefusedError as refusal:
            self._refuse(refusal)
        except (ValueError, OSError) as error:
            self._answer({"error": str(error)}, 400)
        except Exception:
            # Print the error before the answer, which refers to the terminal.
            self.server.handle_error(self.request, self.client_address)
            self._answer({"error": "the server failed; the terminal shows the error"}, 500)

    def _answer(self, value: object, status: int = 200) -> None:
        self._send(status, "application/json", json.dumps(value, allow_nan=False).encode())

    def _refuse(self, refusal: RefusedError) -> None:
        self._answer({"error": str(refusal)}, refusal.status)

    def _send(self, status: int, kind: str, content: bytes) -> None:
        self.connection.settimeout(self.server.seconds)
        self.send_response(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Refuse what the parser refuses, with an answer in JSON like all others."""
        self.close_connection = True
        self._refuse(RefusedError(code, "this server does not know such a request"))

    def log_message(self, format: str, *arguments: object) -> None:
        """Log nothing, because addresses contain the token."""

"""A small HTTP server for one person on this machine, on the standard library's.

Each connection carries one request, has a deadline for all of it, and there are at most so many at once; so neither
slow nor many clients can hold it up. Nothing of a request ever becomes a path of a file.
"""

from __future__ import annotations

import io
import json
import socket
import sys
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import BoundedSemaphore
from typing import TYPE_CHECKING, Final

from iphyre_jax.viewer.page import page_file
from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.guard import MAX_REQUEST, Guard, RefusedError

if TYPE_CHECKING:
    from typing_extensions import Buffer

Request = socket.socket | tuple[bytes, socket.socket]  # as the standard library has it; here always the former
Client = tuple[str, int] | str

CONNECTIONS: Final = 32  # at once; a page needs some ten while it loads
REQUEST_SECONDS: Final = 10.0  # for a request to arrive, and again for its answer to leave

_CONTENT_TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
SCRIPTS: Final = ("tape.js", "stage.js", "clock.js", "deck.js", "client.js", "game.js", "editor.js", "play.js")
FILES: Final = (*SCRIPTS, "style.css")
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class PlayServer(ThreadingHTTPServer):
    """Serves the play page on 127.0.0.1.

    Args:
        api: answers the page's calls.
        token: the first part of every path.
        port: 0 for any that is free.
        seconds: that a request may take to arrive.
    """

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, api: Api, token: str, port: int = 0, seconds: float = REQUEST_SECONDS) -> None:
        self.api, self.seconds = api, seconds
        self._free_connections = BoundedSemaphore(CONNECTIONS)
        super().__init__(("127.0.0.1", port), _Handler)
        self.guard = Guard(token, self.server_port)

    @property
    def address(self) -> str:
        """The page's address."""
        return f"http://127.0.0.1:{self.server_port}/{self.guard.token}/"

    def process_request(self, request: Request, client_address: Client) -> None:
        """Hand a connection to a thread, or close it if there are too many."""
        if not self._free_connections.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Request, client_address: Client) -> None:
        """Serve one connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free_connections.release()

    def handle_error(self, request: Request, client_address: Client) -> None:
        """Say on one line what went wrong; a client that leaves or dawdles is nothing to speak of."""
        error = sys.exception()
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"iphyre-jax play: {type(error).__name__}: {error}", file=sys.stderr)


class _RequestStream(io.RawIOBase):
    """What arrives on a socket until a deadline, and up to a size."""

    def __init__(self, connection: socket.socket, seconds: float) -> None:
        self._connection, self._deadline, self._bytes_left = connection, time.monotonic() + seconds, MAX_REQUEST

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Buffer) -> int:
        left = self._deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError("the request took too long")
        self._connection.settimeout(left)
        count = self._connection.recv_into(memoryview(buffer)[: self._bytes_left])
        self._bytes_left -= count
        return count


class _Handler(BaseHTTPRequestHandler):
    """One request."""

    server: PlayServer
    server_version, sys_version = "iphyre-jax", ""

    def setup(self) -> None:
        """Put the deadline between socket and parser."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BufferedReader(_RequestStream(self.connection, self.server.seconds))

    def do_GET(self) -> None:
        """Send the page or one of its files."""
        try:
            name = self.server.guard.resource_name(self.path, self.headers) or "play.html"
            if name != "play.html" and name not in FILES:
                raise RefusedError(404, "no such file")
            self._send(200, _CONTENT_TYPES[name.rpartition(".")[2]], page_file(name).encode())
        except RefusedError as refusal:
            self._refuse(refusal)

    def do_POST(self) -> None:
        """Answer a call of the page."""
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
            self.server.handle_error(self.request, self.client_address)  # first: the answer says that it is told there
            self._answer({"error": "the server failed; its terminal says how"}, 500)

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
        """Refuse what the parser refuses, in the same form."""
        self.close_connection = True
        self._refuse(RefusedError(code, "not a request that this server knows"))

    def log_message(self, format: str, *arguments: object) -> None:
        """Stay silent: addresses hold the token."""

"""A small HTTP server for one person on this machine, built on the standard library.

Each connection carries one request and has a deadline, and the number of connections is limited. So neither slow nor
many clients can block the server. No part of a request ever becomes the path of a file.
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

Request = socket.socket | tuple[bytes, socket.socket]  # the type in the standard library; here it is always a socket
Client = tuple[str, int] | str

CONNECTIONS: Final = 32  # at once; a page needs about ten while it loads
REQUEST_SECONDS: Final = 10.0  # s, for a request to arrive, and again for the answer to be sent

_CONTENT_TYPES: Final = {"html": "text/html", "js": "text/javascript", "css": "text/css"}
SCRIPTS: Final = ("tape.js", "stage.js", "clock.js", "deck.js", "client.js", "game.js", "editor.js", "play.js")
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


class PlayServer(ThreadingHTTPServer):
    """Serves the play page on 127.0.0.1.

    Args:
        api: answers the calls of the page.
        token: the first part of every path.
        port: 0 for any free port.
        seconds: s, how long a request may take to arrive.
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
        """The address of the page."""
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
        """Print an error in one line. Clients that are slow or close the connection are no errors."""
        error = sys.exception()
        if not isinstance(error, ConnectionError | TimeoutError):
            print(f"iphyre-jax play: {type(error).__name__}: {error}", file=sys.stderr)


class _RequestStream(io.RawIOBase):
    """Read from a socket until a deadline and up to a largest size."""

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
    """Handles one request."""

    server: PlayServer
    server_version, sys_version = "iphyre-jax", ""

    def setup(self) -> None:
        """Let the parser read from the socket only until the deadline."""
        super().setup()
        self.rfile.close()
        self.rfile = io.BufferedReader(_RequestStream(self.connection, self.server.seconds))

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

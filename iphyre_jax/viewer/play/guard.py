"""Decide which requests the play server answers. Every request is checked before anything else happens.

The server listens on this machine only. These dangers remain: other pages in the same browser, which can send requests
with a foreign origin or with a host name of their own that points to 127.0.0.1; other users of the machine, who do not
know the token; and mistakes.
"""

from __future__ import annotations

import hmac
from collections.abc import Sequence
from dataclasses import dataclass
from email.message import Message
from typing import Final

MAX_BODY: Final = 64 * 1024  # bytes; a scene takes about 1 kB
MAX_REQUEST: Final = MAX_BODY + 16 * 1024  # bytes, headers included
OWN_SITES: Final = ("same-origin", "none")  # values of Sec-Fetch-Site: our page, or an address that a person typed


class RefusedError(Exception):
    """A request that the server refuses.

    Args:
        status: the HTTP status.
        reason: one line.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


@dataclass(frozen=True)
class Guard:
    """The rules of one server, which listens on `port` and expects `token`."""

    token: str
    port: int

    @property
    def hosts(self) -> tuple[str, ...]:
        """The host names of this server."""
        return f"127.0.0.1:{self.port}", f"localhost:{self.port}"

    def resource_name(self, path: str, headers: Message) -> str:
        """Return the requested resource: the part of the path after the token.

        Raises:
            RefusedError: host, token, origin or site is wrong.
        """
        host = _single_header(headers, "Host")
        if host not in self.hosts:
            raise RefusedError(403, "another host")
        if not self.knows(path):
            raise RefusedError(403, "another token")
        if headers.get_all("Origin") and _single_header(headers, "Origin") != f"http://{host}":
            raise RefusedError(403, "another origin")
        if headers.get_all("Sec-Fetch-Site") and _single_header(headers, "Sec-Fetch-Site") not in OWN_SITES:
            raise RefusedError(403, "another site")
        return path.split("/", 2)[2]

    def knows(self, path: str) -> bool:
        """Return whether a path begins with the token of this server."""
        parts = path.split("/", 2)
        return len(parts) == 3 and hmac.compare_digest(parts[1].encode(), self.token.encode())

    def body_length(self, headers: Message) -> int:
        """Return the number of bytes of JSON after the headers of a POST request.

        Raises:
            RefusedError: the origin is missing, the type is wrong, or the length is missing, wrong or too large.
        """
        if not headers.get_all("Origin"):
            raise RefusedError(403, "no origin")
        kind = _single_header(headers, "Content-Type").partition(";")[0].strip().lower()
        if kind != "application/json":
            raise RefusedError(415, "expected application/json")
        if headers.get_all("Transfer-Encoding") or headers.get_all("Content-Encoding"):
            raise RefusedError(411, "expected a plain body of a stated length")
        length = _single_header(headers, "Content-Length")
        if not (length.isascii() and length.isdigit()) or len(length) > len(str(MAX_REQUEST)):
            raise RefusedError(413 if length.isdigit() else 411, "expected the body's length in bytes")
        if int(length) > MAX_BODY:
            raise RefusedError(413, f"expected at most {MAX_BODY} bytes")
        return int(length)


def _single_header(headers: Message, name: str) -> str:
    """Return the value of a header, or "" if it is missing or repeated, so that no check accepts it."""
    values: Sequence[str] = headers.get_all(name) or ()
    return values[0] if len(values) == 1 else ""

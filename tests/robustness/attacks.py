"""Attacks on the play server, for `server.py`: each returns whether it was answered as it should be."""

from __future__ import annotations

import json
import random
import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

REFUSED = {400, 403, 404, 405, 408, 411, 413, 414, 415, 422, 431, 501, 503, 505}


@dataclass
class Target:
    """The server under attack."""

    port: int
    token: str
    end: float  # monotonic s
    tried: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def count(self, what: str, fine: bool) -> None:
        """Count a request, and whether its answer was as it should be."""
        with self.lock:
            self.tried[what] += 1
            self.wrong[what] += not fine

    @property
    def over(self) -> bool:
        return time.monotonic() > self.end

    def request(self, path: str, body: bytes = b"{}", **headers: str) -> bytes:
        """Return a POST request as the page sends it, with other headers instead of its own."""
        own = {"Host": f"127.0.0.1:{self.port}", "Origin": f"http://127.0.0.1:{self.port}"}
        own |= {"Content-Type": "application/json", "Content-Length": str(len(body))}
        lines = [f"{name}: {value}" for name, value in {**own, **headers}.items()]
        return "\r\n".join([f"POST {path} HTTP/1.1", *lines, "", ""]).encode() + body

    def ask(self, text: bytes, timeout: float = 30.0) -> tuple[int, bytes]:
        """Send bytes; return the status, 0 if the server closed without an answer, and the body."""
        try:
            with socket.create_connection(("127.0.0.1", self.port), timeout) as connection:
                connection.sendall(text)
                connection.shutdown(socket.SHUT_WR)
                parts = []
                while part := connection.recv(1 << 20):
                    parts.append(part)
        except TimeoutError:
            raise
        except OSError:  # it was closed
            return 0, b""
        head, _, content = b"".join(parts).partition(b"\r\n\r\n")
        words = head.split(None, 2)
        return (int(words[1]) if len(words) > 1 and words[1].isdigit() else 0), content

    def call(self, name: str, fields: dict[str, Any], timeout: float = 30.0) -> tuple[int, Any]:
        """Call the server as the page does."""
        status, content = self.ask(self.request(f"/{self.token}/api/{name}", json.dumps(fields).encode()), timeout)
        return status, json.loads(content) if content else None


Attack = Callable[[Target, random.Random], bool]


def wrong_token(target: Target, rng: random.Random) -> bool:
    """Another token, or almost the right one."""
    token = rng.choice(["", "x", target.token[:-1], target.token.swapcase(), target.token + "a", "%00", "é"])
    return target.ask(target.request(f"/{token}/api/start"))[0] in {0, 400, 403}


def wrong_origin(target: Target, rng: random.Random) -> bool:
    """A foreign page, or a name that points here."""
    headers = rng.choice(
        [
            {"Origin": "http://evil.example"},
            {"Origin": "null"},
            {"Host": "evil.example"},
            {"Host": f"evil.example:{target.port}"},
            {"Sec-Fetch-Site": "cross-site"},
            {"Content-Type": "text/plain"},
        ]
    )
    return target.ask(target.request(f"/{target.token}/api/start", **headers))[0] in {403, 415}


def large_body(target: Target, rng: random.Random) -> bool:
    """More bytes than allowed, said or not."""
    body = b" " * rng.choice([65_537, 200_000])
    said = rng.choice([len(body), 10**12, -1, 10])
    status, _ = target.ask(target.request(f"/{target.token}/api/start", body, **{"Content-Length": str(said)}))
    return status in {0, 400, 411, 413}


def deep_json(target: Target, rng: random.Random) -> bool:
    """JSON that is deep, doubled, or not JSON."""
    body = rng.choice([b"[" * 60_000, b'{"a":' * 10_000, b'{"scene": 1, "scene": 2}', b"\xff", b"1e999", b"9" * 60_000])
    return target.ask(target.request(f"/{target.token}/api/game", body))[0] == 400


def path_out(target: Target, rng: random.Random) -> bool:
    """A path out of the folder."""
    paths = ["../../../etc/passwd", "%2e%2e/%2e%2e/etc/passwd", "..\\..\\x", "oracle-60fps.json", "play.js/../x", "\0"]
    path = rng.choice(paths)
    head = f"GET /{target.token}/{path} HTTP/1.1\r\nHost: 127.0.0.1:{target.port}\r\n\r\n"
    return target.ask(head.encode())[0] in {0, *REFUSED}


def no_http(target: Target, rng: random.Random) -> bool:
    """Bytes that are no request."""
    beginning = b"\x16\x03\x01\x02\x00\x01"  # of TLS
    noise = rng.randbytes(3000) + b"\r\n\r\n"
    text = rng.choice([beginning, noise, b"GET\r\n\r\n", b"\r\n" * 9, b"GET /" + b"a" * 90_000])
    return target.ask(text)[0] in {0, *REFUSED}


def torn(target: Target, rng: random.Random) -> bool:
    """A connection that is reset in the middle of a request that would be right."""
    text = target.request(f"/{target.token}/api/attempt", json.dumps({"scene": "support", "plan": [5, 6]}).encode())
    with socket.create_connection(("127.0.0.1", target.port), 30) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, not end
        connection.sendall(text[: rng.randrange(len(text) - 1)])
    return True


def wrong_fields(target: Target, rng: random.Random) -> bool:
    """Arguments that are JSON and nonsense."""
    plan: Any = rng.choice([[5, 5, -1, -1], [10**400] * 4, [900] * 4, "x", [[]] * 4, [True] * 4, None])
    scene: Any = rng.choice(["/etc/passwd", "hole", {"name": "x"}, ["hole"], 1e308])
    return target.call(rng.choice(["attempt", "record"]), {"scene": scene, "plan": plan})[0] == 400


def heavy_scene(target: Target, rng: random.Random) -> bool:
    """A valid scene that takes very long to compile, each time another one, from a page that knows the token."""
    bars, balls = 49, 15
    pairs = rng.sample([[bars + i, bars + j] for i in range(balls) for j in range(i)], rng.randrange(60, 105))
    corners = [(10 + k % 10 * 58, 200 + k // 10 * 60) for k in range(bars)]
    scene = {
        "schema": "iphyre_jax/scene",
        "version": 1,
        "name": "heavy",
        "block": [[[x, y], [x + 40, y]] for x, y in corners],
        "ball": [[30 + 38 * k, 100, 10] for k in range(balls)],
        "eli": [0] * (bars + balls),
        "dynamic": [0] * bars + [1] * balls,
        "spring": pairs,
        "limits": {"objects": 64, "blocks": 6},
    }
    status, answer = target.call("game", {"scene": scene}, 400)
    return status in {422, 503} and "\n" not in answer["error"]


QUICK_ATTACKS: tuple[Attack, ...] = (
    wrong_token,
    wrong_origin,
    large_body,
    deep_json,
    path_out,
    no_http,
    torn,
    wrong_fields,
)

"""The play server refuses hostile requests and keeps running."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from iphyre_jax import SceneBuilder, load_scene, simulate
from iphyre_jax.scenes import scene_to_dict
from iphyre_jax.viewer.play import reception
from iphyre_jax.viewer.play.api import Api
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.server import CONNECTIONS, FILES, PlayServer
from iphyre_jax.viewer.play.session import Session
from iphyre_jax.viewer.plays import Play, read_plays
from iphyre_jax.viewer.recording import Recording
from iphyre_jax.viewer.sheets import start_of

TOKEN = "a-token"  # noqa: S105 - of this test's own server
PLAN = [-1, -1, 83, 32]


@pytest.fixture
def server(tmp_path: Path) -> Iterator[PlayServer]:
    with PlayServer(Api(Session(tmp_path / "attempts.jsonl")), TOKEN, seconds=2.0) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def ask(
    server: PlayServer, name: str, body: object = None, *, method: str = "POST", **headers: str | None
) -> tuple[int, Any]:
    """Send a request like the page. Given headers replace those of the page; None removes one."""
    own = {
        "Host": f"127.0.0.1:{server.server_port}",
        "Origin": f"http://127.0.0.1:{server.server_port}",
        "Content-Type": "application/json",
    }
    sent = own | {key.replace("_", "-"): value for key, value in headers.items()}
    sent_body = body if isinstance(body, bytes) else json.dumps({} if body is None else body).encode()
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    with closing(connection):
        connection.putrequest(method, f"/{TOKEN}/{name}" if not name.startswith("/") else name, skip_host=True)
        if method == "POST":
            sent.setdefault("Content-Length", str(len(sent_body)))
        for key, value in sent.items():
            if value is not None:
                connection.putheader(key, value)
        connection.endheaders(sent_body if method == "POST" else None)
        answer = connection.getresponse()
        content = answer.read()
    return answer.status, json.loads(content) if "json" in answer.getheader("Content-Type", "") else content


def say(server: PlayServer, text: bytes) -> bytes:
    """Send raw bytes; return the first line of the answer, empty if the server closed the connection."""
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as connection:
        try:
            connection.sendall(text)
            connection.shutdown(socket.SHUT_WR)
            with connection.makefile("rb") as answer:
                return answer.readline()
        except OSError:  # reset, broken or not connected any more
            return b""


def test_a_port_that_is_taken_is_an_error_of_the_system() -> None:
    with (
        PlayServer(Api(Session(None)), TOKEN) as server,
        pytest.raises(OSError, match="in use"),
        PlayServer(Api(Session(None)), TOKEN, server.server_port),
    ):
        pass


def test_the_page_and_its_files_are_served(server: PlayServer) -> None:
    for name in ("", *FILES):
        status, content = ask(server, name, method="GET", Origin=None)
        assert status == 200
        assert len(content) > 200
    assert b"<script>" not in ask(server, "", method="GET")[1]


@pytest.mark.slow
def test_an_attempt_is_scored_as_simulate_does_and_saved(server: PlayServer, tmp_path: Path) -> None:
    status, game = ask(server, "api/game", {"scene": "hole"})
    assert status == 200
    assert game["figures"]["human"] == 966.08
    assert game["play"]["steps"] == 900
    assert game["standing"] == {"series": 1, "rewards": [], "left": 5, "best": None}
    expected = simulate("hole", [PLAN], fps=60, dtype="float64")
    for number in range(1, 6):
        status, answer = ask(server, "api/attempt", {"scene": "hole", "plan": PLAN})
        assert status == 200
        assert answer["play"]["reward"] == expected.reward[0]
        assert answer["standing"]["left"] == 5 - number
    assert ask(server, "api/attempt", {"scene": "hole", "plan": PLAN}) == (409, {"error": "all 5 attempts are used"})
    assert ask(server, "api/again", {"scene": "hole"})[1]["standing"]["series"] == 2
    assert ask(server, "api/attempt", {"scene": "hole", "plan": [-1] * 4})[1]["standing"]["left"] == 4
    plays = read_plays(tmp_path / "attempts.jsonl")
    assert [play.plan for play in plays] == [tuple(PLAN)] * 5 + [(-1,) * 4]
    assert not plays[0].difference(plays[0].record())
    line = json.loads((tmp_path / "attempts.jsonl").read_text("utf-8").splitlines()[-1])
    assert (line["facts"]["series"], line["facts"]["attempt"]) == (2, 1)
    assert {"iphyre_jax", "jax", "numpy"} <= set(line["facts"]["versions"])
    answer = ask(server, "api/agents", {"scene": "hole"})[1]
    assert [play["agent"] for play in answer["plays"]] == ["best plan known", "attempt 1"]
    assert answer["failed"] == []


class FakeSimulator:
    """A simulator that refuses some plays and shows the start of others."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def record(self, play: Play, *, is_game: bool) -> Recording:
        self.asked.append(play.agent)
        if play.agent == "wrong":
            raise ValueError("plan: expected another")
        if play.fps == 10:
            raise RefusedError(503, "the simulator is busy")
        return start_of(play.scene)


def test_plays_that_fail_do_not_hide_the_others() -> None:
    scene, simulator = load_scene("hole"), FakeSimulator()
    agents = [
        Play(agent, scene, (-1,) * 4, fps) for agent, fps in (("wrong", 60), ("slow", 10), ("late", 10), ("a", 60))
    ]
    session = Session(None)
    session.add(start_of(scene))
    answer: Any = Api(session, agents, simulator=simulator).call("api/agents", b'{"scene": "hole"}')  # type: ignore[arg-type]
    assert [play["agent"] for play in answer["plays"]] == ["best plan known", "a", "attempt 1"]
    assert answer["failed"] == [
        "not shown: wrong: plan: expected another",
        "not shown: late, slow: the simulator is busy",
    ]
    assert "late" not in simulator.asked  # its program was refused a moment ago


def test_the_editor_gets_the_errors_of_the_validator(server: PlayServer) -> None:
    scene = scene_to_dict(load_scene("hole"))
    assert ask(server, "api/check", {"scene": scene})[1]["problems"] == []
    answer = ask(server, "api/check", {"scene": {**scene, "eli": [1] * 7, "name": ""}})[1]
    assert [line.partition(":")[0] for line in answer["problems"]] == ["name"]
    answer = ask(server, "api/check", {"scene": {**scene, "eli": [1] * 7}})[1]
    assert [line.partition(":")[0] for line in answer["problems"]] == ["eli[6]", "eli"]
    assert ask(server, "api/check", {"scene": ["x"]})[1]["problems"][0].startswith("expected an object")


def test_the_editor_says_that_a_scene_may_be_too_large(server: PlayServer) -> None:
    pairs = [[i, j] for i in range(9) for j in range(i)]
    for balls, springs, warned in ((9, 11, False), (9, 12, True), (10, 0, True)):
        scene = {
            "schema": "iphyre_jax/scene",
            "version": 1,
            "name": "tied",
            "block": [],
            "ball": [[50 + 50 * k, 100, 10] for k in range(balls)],
            "eli": [0] * balls,
            "dynamic": [1] * balls,
            "spring": pairs[:springs],
        }
        said = f"{springs} joints and springs, {balls} moving objects: preparing this scene takes minutes"
        answer = ask(server, "api/check", {"scene": scene})[1]
        assert answer["problems"] == []
        assert any(line.startswith(said) for line in answer["warnings"]) == warned


def test_names_of_scenes_reach_the_page_as_json_only(tmp_path: Path) -> None:
    names = ["</script><script>alert(1)</script>", "\"' onfocus=alert(2)", "<!--", "\u05d0\u05d1"]
    scenes = []
    for name in names:
        builder = SceneBuilder(name)
        builder.ball((300, 300))
        scenes.append(builder.build())
    with PlayServer(Api(Session(None), scenes=scenes), TOKEN) as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            for text in (f"GET /{TOKEN}/ HTTP/1.1\r\n", f"GET /{TOKEN}/play.js HTTP/1.1\r\n"):
                answer = talk(server, f"{text}Host: 127.0.0.1:{server.server_port}\r\n\r\n".encode())
                assert not any(name.encode() in answer for name in names[:3])
            head = f"POST /{TOKEN}/api/start HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\n"
            origin = f"Origin: http://127.0.0.1:{server.server_port}\r\n"
            rest = "Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"
            header, _, body = talk(server, f"{head}{origin}{rest}".encode()).partition(b"\r\n\r\n")
        finally:
            server.shutdown()
            thread.join()
    assert b"Content-Type: application/json" in header
    assert b"X-Content-Type-Options: nosniff" in header
    assert b"script-src 'self'" in header
    assert body.isascii()
    assert [game["name"] for game in json.loads(body)["games"][-4:]] == names


def talk(server: PlayServer, text: bytes) -> bytes:
    """Send raw bytes and return the whole answer."""
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as connection:
        connection.sendall(text)
        with connection.makefile("rb") as answer:
            return answer.read()


REFUSED: list[tuple[str, dict[str, Any], int]] = [
    ("another host", {"Host": "evil.example"}, 403),
    ("a host that points here", {"Host": "evil.example:80"}, 403),
    ("another port", {"Host": "127.0.0.1:1"}, 403),
    ("no host", {"Host": None}, 403),
    ("another origin", {"Origin": "http://evil.example"}, 403),
    ("the origin of a file", {"Origin": "null"}, 403),
    ("no origin", {"Origin": None}, 403),
    ("https origin", {"Origin": "https://127.0.0.1"}, 403),
    ("another site", {"Sec_Fetch_Site": "cross-site"}, 403),
    ("a sibling site", {"Sec_Fetch_Site": "same-site"}, 403),
    ("no token", {"name": "/api/start"}, 403),
    ("another token", {"name": "/b-token/api/start"}, 403),
    ("a token in capitals", {"name": f"/{TOKEN.upper()}/api/start"}, 403),
    ("a token that is not ASCII", {"name": "/%C3%A9/api/start"}, 403),
    ("a path out of the folder", {"name": "../../../etc/passwd", "method": "GET"}, 404),
    ("the same, encoded", {"name": "%2e%2e%2f%2e%2e%2fetc%2fpasswd", "method": "GET"}, 404),
    ("an absolute path", {"name": "/etc/passwd", "method": "GET"}, 403),
    ("a file of the package", {"name": "oracle-60fps.json", "method": "GET"}, 404),
    ("a Python file", {"name": "../page.py", "method": "GET"}, 404),
    ("no such call", {"name": "api/eval"}, 404),
    ("a form", {"Content_Type": "application/x-www-form-urlencoded"}, 415),
    ("plain text", {"Content_Type": "text/plain"}, 415),
    ("a huge body", {"Content_Length": "100000000000"}, 413),
    ("a body over the limit", {"body": b" " * 65537}, 413),
    ("a negative length", {"Content_Length": "-1"}, 411),
    ("chunks", {"Transfer_Encoding": "chunked", "Content_Length": None}, 411),
    ("no JSON", {"body": b"{"}, 400),
    ("deep JSON", {"body": b"[" * 60000}, 400),
    ("not UTF-8", {"body": b"\xff\xfe"}, 400),
    ("a key twice", {"body": b'{"a": 1, "a": 2}'}, 400),
    ("a foreign field", {"body": {"scene": "hole"}}, 400),
    ("a path for a scene", {"name": "api/game", "body": {"scene": "/etc/passwd"}}, 400),
    ("a plan of another form", {"name": "api/record", "body": {"scene": "hole", "plan": {"a": 1}}}, 400),
    ("a plan of huge numbers", {"name": "api/record", "body": {"scene": "hole", "plan": [10**400] * 4}}, 400),
    ("two removals at once", {"name": "api/attempt", "body": {"scene": "hole", "plan": [5, 5, -1, -1]}}, 400),
    ("a removal after the end", {"name": "api/attempt", "body": {"scene": "hole", "plan": [900, -1, -1, -1]}}, 400),
    ("another method", {"method": "DELETE"}, 501),
    ("a question about methods", {"method": "OPTIONS"}, 501),
]


def test_hostile_requests_are_refused_and_play_goes_on(server: PlayServer, tmp_path: Path) -> None:
    assert len(REFUSED) >= 30
    for what, arguments, expected in REFUSED:
        status, answer = ask(server, **({"name": "api/start"} | arguments))
        assert (what, status) == (what, expected)
        assert "\n" not in str(answer.get("error", "")) or status == 400
    assert not (tmp_path / "attempts.jsonl").exists()
    assert ask(server, "api/attempt", {"scene": "hole", "plan": PLAN})[0] == 200


def test_what_is_no_http_is_refused_and_play_goes_on(server: PlayServer) -> None:
    port = server.server_port
    line = f"GET /{TOKEN}/ HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n"
    for text in (
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",  # the beginning of TLS
        b"GET\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n",
        (line + "a: b\r\n" * 2000 + "\r\n").encode(),
        (line + "x: " + "y" * 200_000 + "\r\n\r\n").encode(),
        (line + f"Host: 127.0.0.1:{port}\r\n\r\n").encode(),  # twice
        b"\x00" * 1000 + b"\r\n\r\n",
    ):
        assert b" 200 " not in say(server, text)
    assert b" 200 " in say(server, (line + "\r\n").encode())


@pytest.mark.slow
def test_floods_and_dawdlers_do_not_hold_up_play(server: PlayServer) -> None:
    begin = time.monotonic()
    held = [socket.create_connection(("127.0.0.1", server.server_port)) for _ in range(3 * CONNECTIONS)]
    try:
        for connection in held[::2]:
            try:
                connection.sendall(f"POST /{TOKEN}/api/start HTTP/1.1\r\n".encode())
            except OSError:  # closed already: there were too many
                continue
        status = None
        while status != 200 and time.monotonic() - begin < 20:  # slow clients get 2 s
            try:
                status, _ = ask(server, "api/start")
            except (OSError, http.client.HTTPException):
                time.sleep(0.1)
        assert status == 200
    finally:
        for connection in held:
            connection.close()


def test_slow_clients_without_a_token_take_no_place(server: PlayServer) -> None:
    port = server.server_port
    beginnings = (b"", b"GET /", b"POST /b-token/api/start HTTP/1.1\r\nHost: x\r\n", f"GET /{TOKEN}/ HTT".encode())
    held = [socket.create_connection(("127.0.0.1", port)) for _ in range(2 * CONNECTIONS)]
    try:
        for number, connection in enumerate(held):
            connection.sendall(beginnings[number % len(beginnings)])
        for name in ["api/start"] * 50:
            assert ask(server, name)[0] == 200
        assert ask(server, "/b-token/api/start")[0] == 403
    finally:
        for connection in held:
            connection.close()


def test_of_too_many_slow_clients_the_oldest_is_cut(server: PlayServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reception, "WAITING", 4)
    held = [socket.create_connection(("127.0.0.1", server.server_port), timeout=10) for _ in range(12)]
    try:
        assert [connection.recv(1) for connection in held[:7]] == [b""] * 7
        assert ask(server, "api/start")[0] == 200
    finally:
        for connection in held:
            connection.close()


@pytest.mark.slow
def test_slow_headers_end_in_time(server: PlayServer) -> None:
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=30) as connection:
        begin = time.monotonic()
        try:
            while time.monotonic() - begin < 25:  # the server allows 2 s, however busily they trickle
                connection.sendall(b"a")
                time.sleep(0.05)
            pytest.fail("the server still reads")
        except OSError:
            pass


def test_long_headers_are_refused(server: PlayServer) -> None:
    line = f"GET /{TOKEN}/ HTTP/1.1\r\nHost: 127.0.0.1:{server.server_port}\r\nx: ".encode()
    assert b" 200 " in say(server, line + b"y" * 15_000 + b"\r\n\r\n")
    assert b" 431 " in say(server, line + b"y" * (reception.MAX_HEADERS - len(line) + 1))


@pytest.mark.slow
def test_an_idle_server_costs_nothing(server: PlayServer) -> None:
    ask(server, "api/start")
    begin, clock = time.process_time(), time.monotonic()
    time.sleep(1.0)
    assert (time.process_time() - begin) / (time.monotonic() - clock) < 0.05


def test_an_internal_error_is_printed_and_the_server_goes_on(
    server: PlayServer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(fields: object) -> object:
        raise RuntimeError("something inside")

    monkeypatch.setitem(server.api._calls, "api/start", (fail, frozenset()))
    assert ask(server, "api/start") == (500, {"error": "the server failed; the terminal shows the error"})
    assert ask(server, "api/check", {"scene": {}})[0] == 200
    assert "RuntimeError: something inside" in capsys.readouterr().err

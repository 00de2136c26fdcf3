"""A tiny server of this machine that speaks both dialects and has the faults that it is told to have."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

REPLY = 'Both go.\n```json\n[{"time": 0.1, "index": 0}, {"time": 0.2, "index": 1}]\n```'
SLOW = 5.0  # s that a slow answer takes


class LanguageServer(ThreadingHTTPServer):
    """Answers with REPLY, after the faults in `faults`, one a request."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.faults: list[str] = []
        self.seen: list[dict[str, Any]] = []  # path, headers and body of each request
        self.closing = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    server: LanguageServer

    def log_message(self, format: str, *args: object) -> None:
        pass

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["content-length"])))
        headers = {name.lower(): value for name, value in self.headers.items()}
        self.server.seen.append({"path": self.path, "headers": headers, "body": body})
        fault = self.server.faults.pop(0) if self.server.faults else ""
        right = json.dumps(_answer(self.path, body))
        secret = headers.get("x-api-key", headers.get("authorization", ""))
        if fault in ("429", "500", "401"):
            more = {"retry-after": "0.25"} if fault == "429" else {}
            self._send(int(fault), json.dumps({"error": {"message": f"refused {secret}", "type": "x"}}), more)
        elif fault == "slow":
            self.server.closing.wait(SLOW)
            self._send(200, right)
        elif fault == "dripping":
            self._drip()
        elif fault == "cut":
            self._send(200, right, length=len(right) + 100)
        elif fault == "no JSON":
            self._send(200, right[: len(right) // 2])
        elif fault == "other JSON":
            self._send(200, json.dumps({"hello": [1, 2]}))
        elif fault == "an error inside":
            self._send(200, json.dumps({"error": {"message": f"overloaded {secret}", "code": 502}}))
        elif fault == "no answer inside":
            self._send(200, json.dumps({**_answer(self.path, body), "choices": [], "content": None}))
        elif fault == "a stream":
            self._send(200, "data: [DONE]", {"content-type": "text/event-stream"})
        elif fault == "a page":
            self._send(200, "<html>log in</html>", {"content-type": "text/html"})
        elif fault == "redirect":
            self._send(307, "", {"location": f"{self.server.url}/elsewhere"})
        elif fault == "odd":  # an answer, with nonsense beside it
            answer = _answer(self.path, body, "x" * 100_000 + REPLY)
            _ended(answer, 7)
            answer["usage"] = dict.fromkeys(answer["usage"], -1.5)
            self._send(200, json.dumps(answer))
        elif fault == "the key at the end":
            self._send(200, json.dumps(_ended(_answer(self.path, body), "x" * 75 + secret.removeprefix("Bearer "))))
        elif fault == "half a character":
            self._send(200, json.dumps(_answer(self.path, body, f"so \ud83d {REPLY}")))
        elif fault == "parts":
            thought = {"type": "thinking", "thinking": "hm", "signature": "x"}
            self._send(200, json.dumps(_answer(self.path, body, [thought, {"type": "text", "text": REPLY}])))
        elif fault == "nothing":
            self._send(200, json.dumps(_answer(self.path, body, [])))
        elif fault == "echo":
            self._send(200, json.dumps(_answer(self.path, body, f"your key is {secret}. {REPLY}")))
        else:
            self._send(200, right)

    def _send(self, status: int, body: str, more: dict[str, str] | None = None, length: int | None = None) -> None:
        self.send_response(status)
        for name, value in {"content-type": "application/json", **(more or {})}.items():
            self.send_header(name, value)
        self.send_header("content-length", str(len(body) if length is None else length))
        self.end_headers()
        self.wfile.write(body.encode())
        self.close_connection = True

    def _drip(self) -> None:
        """A byte now and then: no single wait is long."""
        self.send_response(200)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", "100000")
        self.end_headers()
        while not self.server.closing.wait(0.05):
            try:
                self.wfile.write(b" ")
            except OSError:
                return


def _ended(answer: dict[str, Any], why: object) -> dict[str, Any]:
    """Let an answer say why it ended."""
    for part in (answer, *answer.get("choices", [])):
        part |= {"finish_reason": why, "stop_reason": why}
    return answer


def _answer(path: str, body: dict[str, Any], reply: str | list[dict[str, str]] = REPLY) -> dict[str, Any]:
    if path.endswith("/chat/completions"):
        message = {"role": "assistant", "content": reply}
        return {
            "id": "1",
            "object": "chat.completion",
            "created": 0,
            "model": body["model"],
            "choices": [{"index": 0, "message": message, "finish_reason": "stop"}],
            "usage": {"prompt_tokens": 30, "completion_tokens": 12, "total_tokens": 42},
        }
    texts = [reply[:9], reply[9:]] if isinstance(reply, str) else []
    content = [{"type": "text", "text": text} for text in texts] or reply
    return {
        "id": "1",
        "type": "message",
        "role": "assistant",
        "model": body["model"],
        "content": content,
        "stop_reason": "end_turn",
        "stop_sequence": None,
        "usage": {"input_tokens": 30, "output_tokens": 12},
    }


@contextmanager
def serving() -> Iterator[LanguageServer]:
    """Serve in a thread until the block ends."""
    with LanguageServer() as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield server
        finally:
            server.closing.set()
            server.shutdown()
            thread.join()

"""How a process of our own answers the one that started it (`own_process`): a request a line comes in, answers go out.

An answer is a line too, a JSON object. Its field "bytes" says how many bytes follow.
"""

from __future__ import annotations

import io
import json
import os
import queue
import sys
import threading
from collections.abc import Mapping


def open_answers() -> io.BufferedWriter:
    """Return the output for answers; from now on what libraries print goes to the errors, so that it does not mix."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return answers


def send(answers: io.BufferedWriter, fields: Mapping[str, object], content: bytes = b"") -> None:
    """Write an answer; if whoever asked was killed, this process ends without a word.

    Args:
        answers: `open_answers`.
        fields: JSON values.
        content: bytes that follow the line.
    """
    size = {"bytes": len(content)} if content else {}
    try:
        answers.write(json.dumps({**fields, **size}).encode() + b"\n" + content)
        answers.flush()
    except BrokenPipeError:
        os._exit(0)  # the ordinary way out would close `answers`, which raises the same again


def request_lines() -> queue.SimpleQueue[bytes]:
    """Return the lines of the input as they come; this process ends with its input, whatever it is doing then."""
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin.buffer:
            lines.put(line)
        os._exit(0)  # nobody waits for an answer

    threading.Thread(target=read, daemon=True).start()
    return lines


def next_request(lines: queue.SimpleQueue[bytes], idle: float | None) -> bytes:
    """Return the next line; this process ends if none comes for `idle` seconds (None: it waits for ever)."""
    try:
        return lines.get(timeout=idle)
    except queue.Empty:
        os._exit(0)  # the ordinary way out aborts: the thread that reads holds the lock of the input

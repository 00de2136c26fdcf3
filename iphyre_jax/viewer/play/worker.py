"""The process that plays for the page: `python -m iphyre_jax.viewer.play.worker '{"memory": ..., ...}'`.

Loaded programs take much memory (5 MB of a large scene's machine code take 200) and a compilation may take minutes. A
process of its own can be ended, and gives all of it back.

It reads a request a line, {"scene": contents of a scene file, "plan": steps, "fps": n, "dtype": name, "resets": n,
"compile": whether it may}, and answers with a line and, after a play, with arrays: {"result": fields, "memory": bytes,
"bytes": n} and n bytes of an NPZ; {"missing": true} for a program that had to be compiled; {"error": text,
"is_mistake": of the request}. It ends when its input ends, even during a compilation, or when it was idle for a while.
"""

from __future__ import annotations

import io
import json
import os
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.execution.requests import next_request, open_answers, request_lines, send
from iphyre_jax.scenes import scene_from_dict
from iphyre_jax.viewer.recording import NotCompiledError, Recording, record

ARRAYS: Final = ("poses", "velocities", "contacts")
RESULTS: Final = ("success", "steps", "eliminations", "reward", "fault")


def main() -> None:
    """Answer requests until the input ends.

    The first argument is a JSON object: "memory" (bytes of address space, also of a compilation; 0 for no limit),
    "niceness", and "idle" (s; null to stay).
    """
    settings = json.loads(sys.argv[1])
    _limit(settings["memory"], settings["niceness"])
    answers, requests = open_answers(), request_lines()
    send(answers, {})
    while True:
        send(answers, *_answer(json.loads(next_request(requests, settings["idle"]))))


def _limit(memory: int, niceness: int) -> None:
    """Limit this process and the compilations that it starts."""
    if memory:
        try:
            import resource  # not on Windows
        except ImportError:
            return
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    if niceness:
        os.nice(niceness)


def _answer(request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    """Play, unless the program is missing and must not be compiled."""
    settings = {name: request[name] for name in ("fps", "dtype", "resets")}
    try:
        scene = scene_from_dict(request["scene"])
        recording = record(scene, request["plan"], may_compile=request["compile"], **settings)
    except NotCompiledError:
        return {"missing": True}, b""
    except ValueError as error:
        return {"error": str(error), "is_mistake": True}, b""
    except MemoryError:
        os._exit(1)  # as where a library finds none: the server says what that means
    except Exception as error:  # of any type: the server must learn of it
        return {"error": f"{type(error).__name__}: {error}".partition("\n")[0], "is_mistake": False}, b""
    content = _pack(recording)
    result = {name: getattr(recording, name) for name in RESULTS}
    return {"result": result, "memory": memory_in_use()}, content


def _pack(recording: Recording) -> bytes:
    file = io.BytesIO()
    np.savez(file, **{name: getattr(recording, name) for name in ARRAYS})
    return file.getvalue()


def memory_in_use(process: int | None = None) -> int:
    """Return the resident memory of a process, bytes; by default of this one. 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{process or 'self'}/statm").read_text("ascii").split()
        return int(fields[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 0


if __name__ == "__main__":
    main()

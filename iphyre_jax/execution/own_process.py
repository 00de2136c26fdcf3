"""A process of our own, as the one that started it sees it; `requests` is the other side."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, Final, cast

from iphyre_jax.checks import show

MAX_BYTES: Final = 2**30  # behind an answer: more than any play or chunk of scenes has


class EndedError(RuntimeError):
    """The process cannot be started, or has ended without an answer."""


class OwnProcess:
    """A process that answers one request after another; only one thread may ask at a time.

    Args:
        command: what follows the interpreter and its own options, such as ("-m", module).
        environment: variables, beside those that let it import what this process does, on a CPU.
        quiet: whether what it prints as errors is dropped.

    Raises:
        EndedError: it cannot be started; one line.
    """

    def __init__(self, command: Sequence[str], environment: Mapping[str, str], *, quiet: bool = False) -> None:
        own = {"PYTHONPATH": import_path(), "JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3"}
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-P", *command],
                env={**environment, **own},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL if quiet else None,
                start_new_session=True,  # Ctrl-C reaches only us, and we end it
            )
        except OSError as error:
            raise EndedError(f"no process can be started ({error.strerror})") from None

    @property
    def number(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def ask(self, request: Mapping[str, object] | None, seconds: float | None = None) -> tuple[dict[str, Any], bytes]:
        """Send a request, and return the fields of the answer and the bytes behind it.

        Args:
            request: JSON values; None to wait for what the process says when it has started.
            seconds: for the answer; None for no limit.

        Raises:
            TimeoutError: the answer took longer, "took longer than 3 s"; the process has ended.
            EndedError: it ended without an answer, or said something else; "ended with status 1".
        """
        timed_out = threading.Event()

        def time_out() -> None:
            timed_out.set()
            self._process.kill()  # which ends the answer that is waited for

        timer = None if seconds is None else threading.Timer(seconds, time_out)
        try:
            if timer is not None:
                timer.daemon = True
                timer.start()
            if request is not None:
                questions = cast(IO[bytes], self._process.stdin)
                questions.write(json.dumps(request).encode() + b"\n")
                questions.flush()
            return self._answer()
        except (OSError, ValueError, EndedError) as error:
            status = self.end()
            if timed_out.is_set():
                raise TimeoutError(f"took longer than {seconds:g} s") from None
            if isinstance(error, EndedError):
                raise
            # It does not read, or another thread has closed the pipes.
            raise EndedError(f"ended with status {status}") from None
        finally:
            if timer is not None:
                timer.cancel()

    def _answer(self) -> tuple[dict[str, Any], bytes]:
        answers = cast(IO[bytes], self._process.stdout)
        if (line := answers.readline()).endswith(b"\n"):
            fields = _answer_in(line)
            if fields is None:  # such as a line that a sitecustomize of the user prints
                raise EndedError(f"answered {show(line.decode(errors='replace').rstrip())}")
            size = fields.get("bytes", 0)
            if len(content := answers.read(size)) == size:
                return fields, content
        raise EndedError(f"ended with status {self.end()}")

    def end(self) -> int:
        """End the process, whatever it does, and close its pipes; its status. What was not yet written is lost."""
        self._process.kill()
        status = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            with suppress(OSError, ValueError):
                cast(IO[bytes], pipe).close()
        return status


def _answer_in(line: bytes) -> dict[str, Any] | None:
    """The fields of an answer; None if the line is none."""
    try:
        fields = json.loads(line)
    except ValueError:
        return None
    size = fields.get("bytes", 0) if isinstance(fields, dict) else None
    return fields if isinstance(size, int) and 0 <= size < MAX_BYTES else None


def import_path() -> str:
    """Return the PYTHONPATH with which a new process, in any folder, imports what this one does."""
    entries = [entry for entry in sys.path if isinstance(entry, str)]  # import skips all others
    with suppress(FileNotFoundError):  # the working folder may be gone
        return os.pathsep.join(entry or str(Path.cwd()) for entry in entries)
    return os.pathsep.join(filter(None, entries))

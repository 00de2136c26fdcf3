"""One process of `viewer.play.worker`, as its server sees it."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import IO, Any, Final, cast

import numpy as np

from iphyre_jax.execution.forks import end_process, import_path
from iphyre_jax.viewer.play.worker import ARRAYS

WORKER: Final = "iphyre_jax.viewer.play.worker"
START_SECONDS: Final = 120.0  # s, on a machine that is very busy


class EndedError(RuntimeError):
    """The process has ended without an answer."""


class PlayProcess:
    """A process that plays one request after another; only one thread may ask at a time.

    Args:
        settings: the first argument of `worker`.
        environment: variables, beside those of this process.

    Raises:
        EndedError: it cannot be started, or takes too long to start.
    """

    def __init__(self, settings: Mapping[str, object], environment: Mapping[str, str]) -> None:
        own = {"JAX_PLATFORMS": "cpu", "TF_CPP_MIN_LOG_LEVEL": "3", "PYTHONPATH": import_path()}
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-P", "-m", WORKER, json.dumps(settings)],
                env={**os.environ, **own, **environment},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C reaches only us; the process ends with its input
            )
        except OSError as error:
            raise EndedError(f"no process can be started ({error.strerror})") from None
        try:
            self._within(START_SECONDS, self._answer)
        except TimeoutError as error:
            raise EndedError(str(error)) from None

    @property
    def number(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def ask(self, request: Mapping[str, object], seconds: float) -> dict[str, Any]:
        """Send a request and return the answer; the arrays of a play are its field "arrays".

        Raises:
            TimeoutError: the answer took longer; the process has ended.
            EndedError: the process ended by itself.
        """

        def exchange() -> dict[str, Any]:
            questions = cast(IO[bytes], self._process.stdin)
            questions.write(json.dumps(request).encode() + b"\n")
            questions.flush()
            return self._answer()

        return self._within(seconds, exchange)

    def end(self) -> None:
        """End the process, even during a play. Its compiler ends with it."""
        end_process(self._process)

    def _within(self, seconds: float, act: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        timed_out = threading.Event()

        def end() -> None:
            timed_out.set()
            self._process.kill()  # which ends the answer that is waited for

        timer = threading.Timer(seconds, end)
        timer.daemon = True
        timer.start()
        try:
            answer = act()
        except (OSError, ValueError, EndedError) as error:
            if timed_out.is_set():
                raise TimeoutError(f"the play took longer than {seconds:g} s") from None
            raise EndedError(str(error)) from None
        finally:
            timer.cancel()
        return answer

    def _answer(self) -> dict[str, Any]:
        answers = cast(IO[bytes], self._process.stdout)
        line = answers.readline()
        if not line.endswith(b"\n"):
            raise EndedError("the process has ended")
        answer: dict[str, Any] = json.loads(line)
        if "bytes" in answer:
            content = answers.read(answer["bytes"])
            if len(content) < answer["bytes"]:
                raise EndedError("the process has ended")
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                answer["arrays"] = {name: arrays[name] for name in ARRAYS}
        return answer

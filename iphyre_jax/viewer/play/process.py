"""One process of `viewer.play.worker`, as its server sees it."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from iphyre_jax.execution.own_process import EndedError, OwnProcess
from iphyre_jax.viewer.play.worker import ARRAYS

WORKER: Final = "iphyre_jax.viewer.play.worker"
START_SECONDS: Final = 120.0  # s, on a machine that is very busy


class PlayProcess:
    """A process that plays one request after another; only one thread may ask at a time.

    Args:
        settings: the first argument of `worker`.
        environment: variables, beside those of this process.

    Raises:
        EndedError: it cannot be started, or takes too long to start.
    """

    def __init__(self, settings: Mapping[str, object], environment: Mapping[str, str]) -> None:
        self._process = OwnProcess(("-m", WORKER, json.dumps(settings)), {**os.environ, **environment})
        try:
            self._process.ask(None, START_SECONDS)
        except TimeoutError as error:
            raise EndedError(str(error)) from None

    @property
    def number(self) -> int:
        """The number of the process."""
        return self._process.number

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.runs

    def ask(self, request: Mapping[str, object], seconds: float) -> dict[str, Any]:
        """Send a request and return the answer; the arrays of a play are its field "arrays".

        Raises:
            TimeoutError: the answer took longer; the process has ended.
            EndedError: the process ended by itself.
        """
        answer, content = self._process.ask(request, seconds)
        if content:
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                answer["arrays"] = {name: arrays[name] for name in ARRAYS}
        return answer

    def end(self) -> None:
        """End the process, even during a play. Its compiler ends with it."""
        self._process.end()

"""Chunks of scenes on all cores, in processes of their own.

Drawing and packing scenes is Python, which one process runs on one core only.
"""

from __future__ import annotations

import io
import os
from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from functools import partial
from itertools import count
from queue import SimpleQueue
from threading import Event
from typing import Final

import numpy as np

from iphyre_jax.data.generated.chunks import Arrays, make_chunk
from iphyre_jax.data.generated.pool import GeneratorSettings
from iphyre_jax.execution import configuration
from iphyre_jax.execution.own_process import EndedError, OwnProcess

COMMAND: Final = ("-m", "iphyre_jax.data.generated")

Keep = Callable[[int, Callable[[], Arrays]], Arrays]
"""Of a chunk's number and of what works it out: the chunk, perhaps as it was kept."""


def all_chunks(settings: GeneratorSettings, keep: Keep) -> Generator[Arrays]:
    """Yield chunks 0, 1, ... without end, each as `keep` returns it.

    The first is worked out here, with all threads, for it often suffices. The others come from processes, one for each
    thread that may play.
    """
    yield keep(0, partial(make_chunk, settings, 0))
    threads = configuration.threads()
    if threads == 1:
        for number in count(1):
            yield keep(number, partial(make_chunk, settings, number))
    with closing(ChunkProcesses(settings, threads)) as processes, ThreadPoolExecutor(threads) as helpers:
        ahead: deque[Future[Arrays]] = deque()
        try:
            for number in count(1):
                ahead.append(helpers.submit(keep, number, partial(processes.chunk, number)))
                if len(ahead) > threads:
                    yield ahead.popleft().result()
        finally:
            processes.close()
            for waiting in ahead:
                waiting.cancel()


class ChunkProcesses:
    """Processes that work out chunks; each starts when it is first needed.

    Args:
        settings: of the scenes.
        count: the number of processes; so many threads may ask at once.
    """

    def __init__(self, settings: GeneratorSettings, count: int) -> None:
        self._settings, self._closed = settings, Event()
        self._all = [ChunkProcess(settings) for _ in range(count)]
        self._idle: SimpleQueue[ChunkProcess] = SimpleQueue()
        for process in self._all:
            self._idle.put(process)

    def chunk(self, number: int) -> Arrays:
        """Work out a chunk; where no process can be started, or one has ended, this process does it.

        Raises:
            EndedError: the processes were closed.
        """
        process = self._idle.get()
        try:
            return process.chunk(number)
        except EndedError:
            if self._closed.is_set():
                raise
            return make_chunk(self._settings, number)  # and says what is wrong
        finally:
            self._idle.put(process)

    def close(self) -> None:
        """End all processes, whatever they do."""
        self._closed.set()
        for process in self._all:
            process.end()


class ChunkProcess:
    """A process that works out one chunk after another."""

    def __init__(self, settings: GeneratorSettings) -> None:
        self._arguments = (str(settings.seed), settings.protocol.name, settings.kind)
        self._running: OwnProcess | None = None

    def chunk(self, number: int) -> Arrays:
        """Work out a chunk.

        Raises:
            EndedError: the process cannot be started, or has ended.
        """
        if self._running is None:
            folder = configuration.cache_folder()
            environment = {**os.environ, "IPHYRE_JAX_CACHE": str(folder or "off")}
            self._running = OwnProcess([*COMMAND, *self._arguments], environment)
        _, content = self._running.ask({"chunk": number})
        if not content:
            raise EndedError("answered nothing")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return dict(arrays)

    def end(self) -> None:
        """End the process."""
        if self._running is not None:
            self._running.end()

"""Compilation in separate processes, which keep compiler options, interrupts and crashes to themselves."""

from __future__ import annotations

import atexit
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation.options import xla_flags
from iphyre_jax.execution.own_process import EndedError, OwnProcess

WORKER: Final = "iphyre_jax.execution.compilation.worker"
PATIENCE: Final = 1.5  # s of waiting before progress is shown
LOOK_EVERY: Final = 0.2  # s

_OURS: Final = ("JAX_", "XLA_", "IPHYRE_JAX_")  # settings of the user's process, which must not reach a compiler


class CompilationError(RuntimeError):
    """A program could not be compiled in a separate process."""


@dataclass(frozen=True)
class Job:
    """One program to compile."""

    program: object  # from `describe`
    path: Path
    key: Mapping[str, Any]
    options: Mapping[str, str]  # of the compiler, name -> value


class CompilerProcess:
    """A process that compiles one program after another.

    Args:
        options: compiler options, name -> value.

    Raises:
        CompilationError: it cannot be started, or its compiler rejects the options.
    """

    def __init__(self, options: Mapping[str, str]) -> None:
        self.options, self.is_new = dict(options), True
        kept = {name: value for name, value in os.environ.items() if not name.startswith(_OURS)}
        try:
            self._process = OwnProcess(("-m", WORKER), {**kept, "XLA_FLAGS": xla_flags(options)}, quiet=True)
        except EndedError as error:
            raise CompilationError(str(error)) from None
        self._ask(None, None)

    def compile(self, job: Job, timeout: float | None) -> None:
        """Compile a program into its file.

        Raises:
            TimeoutError: it took longer than `timeout` seconds; the process has ended.
            CompilationError: it failed.
        """
        self._ask({"program": job.program, "path": str(job.path), "key": dict(job.key)}, timeout)

    def _ask(self, request: Mapping[str, object] | None, timeout: float | None) -> None:
        try:
            answer, _ = self._process.ask(request, timeout)
        except TimeoutError as error:
            raise TimeoutError(f"compiling a program {error}") from None
        except EndedError as error:
            raise CompilationError(f"the compiling process {error}") from None
        if error_text := answer.get("error"):
            raise CompilationError(error_text)

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.runs

    def end(self) -> None:
        """End the process, even during a compilation."""
        self._process.end()


_idle: list[CompilerProcess] = []  # idle processes; they end by themselves after a while
_lock = threading.Lock()
_owner = os.getpid()


@atexit.register
def end_idle() -> None:
    """End the idle processes."""
    if os.getpid() != _owner:
        return  # a forked child; they are its parent's, and the lock may be held by a thread that is not here
    with _lock:
        while _idle:
            _idle.pop().end()


def compile_all(jobs: Sequence[Job], show: Callable[[int, int], None]) -> None:
    """Compile programs side by side, one process for each usable core, and wait for all of them.

    An interrupt or an error ends the processes at once.

    Args:
        jobs: the programs.
        show: called with the number of finished programs and of all, from time to time if compilation takes long.

    Raises:
        TimeoutError: one took longer than `configure(compile_timeout=...)` allows.
        CompilationError: a process cannot be started, or a program cannot be compiled.
    """
    busy: list[CompilerProcess] = []
    stopped = threading.Event()

    def run(job: Job) -> None:
        for process in _processes(job.options):
            busy.append(process)
            if stopped.is_set():
                process.end()
                return
            try:
                process.compile(job, configuration.compile_timeout())
            except CompilationError:
                if process.is_new or process.runs:
                    process.end()
                    raise
                continue  # it was idle and has just ended
            finally:
                busy.remove(process)
            process.is_new = False
            with _lock:
                _idle.append(process)
            return

    workers = min(len(jobs), configuration.usable_cores())
    with ThreadPoolExecutor(workers, thread_name_prefix="iphyre_jax_compile") as pool:
        futures = [pool.submit(run, job) for job in jobs]
        began = time.monotonic()
        try:
            left = set(futures)
            while left:
                done, left = wait(left, LOOK_EVERY, FIRST_EXCEPTION)
                for future in done:
                    future.result()
                if time.monotonic() - began > PATIENCE:
                    show(len(jobs) - len(left), len(jobs))
        except BaseException:
            stopped.set()
            for future in futures:
                future.cancel()
            for process in list(busy):
                process.end()
            raise


def _processes(options: Mapping[str, str]) -> Iterator[CompilerProcess]:
    """Yield processes for a job: idle ones, then a new one."""
    while True:
        with _lock:
            process = next((known for known in _idle if known.options == options), None)
            if process is not None:
                _idle.remove(process)
        if process is None:
            break
        if process.runs:
            yield process
        else:
            process.end()
    yield CompilerProcess(options)

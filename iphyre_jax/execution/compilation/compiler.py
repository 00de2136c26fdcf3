"""Compilation in separate processes, which keep compiler options, interrupts and crashes to themselves."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, cast

from iphyre_jax.checks import show
from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation.options import xla_flags
from iphyre_jax.execution.forks import end_process, import_path

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
        quiet = {"TF_CPP_MIN_LOG_LEVEL": "3", "JAX_PLATFORMS": "cpu", "XLA_FLAGS": xla_flags(options)}
        quiet["PYTHONPATH"] = import_path()
        try:
            self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
                [sys.executable, "-P", "-m", WORKER],
                env={**kept, **quiet},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                start_new_session=True,  # Ctrl-C reaches only us, and we end it
            )
        except OSError as error:
            raise CompilationError(f"no process can be started ({error.strerror})") from None
        self._answer()

    def compile(self, job: Job, timeout: float | None) -> None:
        """Compile a program into its file.

        Raises:
            TimeoutError: it took longer than `timeout` seconds; the process has ended.
            CompilationError: it failed.
        """
        request = {"program": job.program, "path": str(job.path), "key": dict(job.key)}
        timed_out = threading.Event()

        def end() -> None:
            timed_out.set()
            self.end()

        timer = threading.Timer(timeout, end) if timeout else None
        try:
            if timer:
                timer.start()
            questions = cast(IO[str], self._process.stdin)
            questions.write(json.dumps(request) + "\n")
            questions.flush()
            self._answer()
        except (OSError, CompilationError) as error:
            if timed_out.is_set():
                raise TimeoutError(f"compiling a program took longer than {timeout:g} s") from None
            raise CompilationError(str(error)) from None
        finally:
            if timer:
                timer.cancel()

    def _answer(self) -> None:
        line = cast(IO[str], self._process.stdout).readline()
        if not line:
            self.end()
            raise CompilationError(f"the compiling process ended with status {self._process.wait()}")
        try:
            answer = json.loads(line)
        except ValueError:  # such as a line that a sitecustomize of the user prints
            self.end()
            raise CompilationError(f"the compiling process answered {show(line.rstrip())}") from None
        if error := answer.get("error"):
            raise CompilationError(error)

    @property
    def runs(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def end(self) -> None:
        """End the process, even during a compilation."""
        end_process(self._process)


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

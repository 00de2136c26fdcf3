"""Executables of programs: from memory, from the cache folder, or compiled in a separate process and cached.

If a program cannot be compiled in a separate process, or this jaxlib cannot load the result, it is compiled in the
user's process, without our compiler options. A warning says what that costs.
"""

from __future__ import annotations

import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import jax
import numpy as np

from iphyre_jax.execution import configuration
from iphyre_jax.execution.compilation import cache_folder
from iphyre_jax.execution.compilation.client import Arrays, ClientArray, Executable, give_back_memory
from iphyre_jax.execution.compilation.compiler import CompilationError, Job, compile_all
from iphyre_jax.execution.compilation.description import describe, source_sum
from iphyre_jax.execution.compilation.options import options_for
from iphyre_jax.execution.forks import check_fork
from iphyre_jax.execution.machine_code.linked import LinkedProgram
from iphyre_jax.execution.programs import InPlaceProgram, Program

Run = Callable[..., Arrays]

LOADED: Final = 96  # programs in memory, some 20 MB each; the least recently prepared goes first
COST: Final = "steps may take 3 times as long"
PATIENCE: Final = 300.0  # s, that another process may take to compile what this one waits for
TELL_EVERY: Final = 60.0  # s of compilation, where there is no terminal
SLOW: Final = "ten and more moving objects take minutes; configure(compile_timeout=...) sets a limit"

_loaded: dict[Program, Run | LinkedProgram] = {}
_in_flight: dict[Program, threading.Event] = {}
_lock = threading.Lock()


def executable(program: Program) -> Run:
    """Return a program as a function of NumPy arrays; it is compiled if necessary."""
    run = _ready(program)
    if isinstance(run, LinkedProgram):
        raise TypeError(f"program: expected one that the host calls, got {program}")
    return run


def linked(programs: Sequence[Program]) -> list[LinkedProgram] | None:
    """Return programs as parts of the user's program; they are compiled if necessary. None if one cannot be linked."""
    prepare(programs)
    runs = [_ready(program) for program in programs]
    found = [run for run in runs if isinstance(run, LinkedProgram)]
    return found if len(found) == len(runs) else None


def _ready(program: Program) -> Run | LinkedProgram:
    while (run := _loaded.get(program)) is None:
        prepare([program])
    return run


def load_cached(program: Program) -> bool:
    """Load a program that is in memory or in the cache folder; return whether it was there. Nothing is compiled."""
    if program in _loaded:
        return True
    folder = configuration.cache_folder()
    return folder is not None and _load(program, *_entry(program, folder))


def prepare(programs: Sequence[Program]) -> None:
    """Load programs, and compile those that are not cached, side by side.

    Raises:
        TimeoutError: one took longer than `configure(compile_timeout=...)` allows.
    """
    check_fork()
    with _lock:
        asked = list(dict.fromkeys(programs))
        _loaded.update([(program, _loaded.pop(program)) for program in asked if program in _loaded])  # to the end
        wanted = [program for program in asked if program not in _loaded]
        others = [_in_flight[program] for program in wanted if program in _in_flight]
        own = [program for program in wanted if program not in _in_flight]
        _in_flight.update((program, threading.Event()) for program in own)
    try:
        if own:
            _load_or_compile(own)
    finally:
        with _lock:
            for program in own:
                _in_flight.pop(program).set()
    for event in others:
        event.wait()


def _load_or_compile(programs: Sequence[Program]) -> None:
    folder = configuration.cache_folder()
    if folder is not None:
        _load_all(programs, folder)
        return
    with tempfile.TemporaryDirectory(prefix="iphyre_jax_") as temporary:
        _load_all(programs, Path(temporary))


def _keep(program: Program, run: Run | LinkedProgram) -> None:
    with _lock:
        dropped = [_loaded.pop(old) for old in list(_loaded)[: max(0, len(_loaded) + 1 - LOADED)]]
        _loaded[program] = run
    if dropped:
        dropped.clear()
        give_back_memory()


def _load_all(programs: Sequence[Program], folder: Path) -> None:
    """Load programs. One process compiles a missing program, while others that need it wait."""
    entries = {program: _entry(program, folder) for program in programs}
    left = [program for program in programs if not _load(program, *entries[program])]
    is_stuck = False  # a claim outlived our patience: its process is stopped, or slower than we would be
    while left:
        with ExitStack() as claims:
            own = [p for p in left if claims.enter_context(cache_folder.claimed(entries[p][0])) or is_stuck]
            missing = [program for program in own if not _load(program, *entries[program])]
            if missing:
                _compile_all(missing, entries, folder)
        left = [program for program in left if program not in own]
        until = time.monotonic() + (configuration.compile_timeout() or PATIENCE)
        waited = [
            cache_folder.wait_for_claim(entries[program][0], until, partial(_show, done, len(left)))
            for done, program in enumerate(left)
        ]
        is_stuck = not all(waited)
        _clear()
        left = [program for program in left if not _load(program, *entries[program])]


def _compile_all(
    missing: Sequence[Program], entries: Mapping[Program, tuple[Path, dict[str, Any]]], folder: Path
) -> None:
    with _room(folder) as place:
        if place != folder:
            entries = {program: _entry(program, place) for program in missing}
        jobs = [Job(describe(program), *entries[program], options_for(program.lanes)) for program in missing]
        try:
            compile_all(jobs, _show)
            cache_folder.remove_old_entries(place)
        except CompilationError as error:
            problem = str(error)
        else:
            problem = "the compiled program cannot be loaded"
        finally:
            _clear()
        for program in missing:
            if not _load(program, *entries[program]):
                text = f"programs are compiled in this process, without compiler options ({problem}); {COST}"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
                _keep(program, run_in_jax(program.run, program.dtype))


@contextmanager
def _room(folder: Path) -> Iterator[Path]:
    """Yield the folder, or a temporary one if nothing can be written there."""
    try:
        cache_folder.check_room(folder)
    except OSError as error:
        reason = f"cache: cannot write into {folder}: {error.strerror}"
        warnings.warn(f"compiled programs are not kept ({reason})", RuntimeWarning, stacklevel=6)
    else:
        yield folder
        return
    with tempfile.TemporaryDirectory(prefix="iphyre_jax_") as temporary:
        yield Path(temporary)


def _load(program: Program, path: Path, key: Mapping[str, Any]) -> bool:
    """Load an entry of the cache; return whether it succeeded."""
    payload = cache_folder.read_entry(path, key)
    if payload is None:
        return False
    try:
        run = LinkedProgram(payload, program.in_place) if isinstance(program, InPlaceProgram) else Executable(payload)
    except Exception:  # another jaxlib wrote it, or this one lacks the calls that load it
        return False
    _keep(program, run)
    return True


def run_in_jax(function: Callable[..., tuple[jax.Array, ...]], dtype: str) -> Run:
    """Return a traced function as a function of NumPy arrays, compiled by the user's JAX."""
    run = jax.jit(function)

    def call(*arrays: np.ndarray[Any, Any] | ClientArray) -> Arrays:
        given = [np.asarray(array.array) if isinstance(array, ClientArray) else array for array in arrays]
        with jax.enable_x64(dtype == "float64"):
            return tuple(np.asarray(result) for result in run(*given))

    return call


def _entry(program: Program, folder: Path) -> tuple[Path, dict[str, Any]]:
    """Return path and key of a program's entry; the key is everything that determines the machine code."""
    key = {
        "program": describe(program),
        "source": source_sum(program.sources),
        "jax": version("jax"),
        "jaxlib": version("jaxlib"),
        "options": dict(options_for(program.lanes)),
        "machine": cache_folder.machine(),
    }
    return cache_folder.entry_path(folder, key), key


@dataclass
class _Progress(threading.local):
    """What a thread has shown of its compilations."""

    line: str = ""  # in the terminal
    begun: float | None = None  # monotonic s
    told: int = 0  # lines that stay


_shown = _Progress()


def _show(done: int, total: int) -> None:
    """Show the progress of compilation: in a line of the terminal, which `_clear` removes; else in a line a minute."""
    if sys.stderr is None:
        return
    _shown.begun = time.monotonic() if _shown.begun is None else _shown.begun
    seconds = time.monotonic() - _shown.begun
    line = f"compiling {min(done + 1, total)} of {total} programs, {seconds:.0f} s"
    if sys.stderr.isatty():
        _shown.line = line
        print(f"\r{line}", end="", file=sys.stderr, flush=True)
    elif seconds >= TELL_EVERY * (_shown.told + 1):
        _shown.told += 1
        print(f"iphyre_jax: {line}; {SLOW}", file=sys.stderr, flush=True)


def _clear() -> None:
    """Remove the line of the terminal, and begin anew."""
    if _shown.line:
        print("\r" + " " * len(_shown.line) + "\r", end="", file=sys.stderr, flush=True)
    _shown.line, _shown.begun, _shown.told = "", None, 0

"""The process that compiles programs: `python -m iphyre_jax.execution.compilation.worker`.

It reads one request a line, {"program": description, "path": file, "key": values}, writes the executable into the file
as an entry of the cache, and answers with one line, {} or {"error": text}. Its compiler options come from XLA_FLAGS. It
ends when its input ends, even during a compilation, or when no request comes for a while.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any, Final

import jax

from iphyre_jax.execution.compilation.cache_folder import write_entry
from iphyre_jax.execution.compilation.client import serialized
from iphyre_jax.execution.compilation.description import from_description, source_sum, source_sums, sum_of
from iphyre_jax.execution.machine_code.trial import compile_in_place
from iphyre_jax.execution.programs import InPlaceProgram, Program
from iphyre_jax.execution.requests import next_request, open_answers, request_lines, send

IDLE_SECONDS: Final = 60.0
CHANGED: Final = "the package's files have changed since this process started"
CLEAR_AFTER: Final = 16  # programs; JAX keeps what it knows of each


def compile_program(program: Program) -> bytes:
    """Return the executable of a program, serialised."""
    with jax.enable_x64(program.dtype == "float64"):
        if isinstance(program, InPlaceProgram):
            return compile_in_place(program)
        return serialized(jax.jit(program.run, keep_unused=True).lower(*program.arguments()).compile())


def _answer(line: bytes) -> dict[str, Any]:
    try:
        request = json.loads(line)
        program, wanted = from_description(request["program"]), request["key"]["source"]
        if source_sum(program.sources) != wanted:
            return {"error": CHANGED}
        payload = compile_program(program)
        if sum_of(program.sources, source_sums()) != wanted:  # it may have imported something new meanwhile
            return {"error": CHANGED}
        write_entry(Path(request["path"]), request["key"], payload)
    except Exception as error:  # of any type: the asking process must learn of it
        return {"error": f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"}
    return {}


def main() -> None:
    """Answer requests until the input ends, or none comes for a while."""
    answers = open_answers()
    jax.jit(lambda x: x + 1)(1.0).block_until_ready()  # an unknown option ends the process here
    send(answers, {})
    requests = request_lines()
    for number in itertools.count(1):
        line = next_request(requests, IDLE_SECONDS)
        if number % CLEAR_AFTER == 0:
            jax.clear_caches()
        send(answers, _answer(line))


if __name__ == "__main__":
    main()

"""Bad arguments: each is refused in one line, within 2 s and 1 GB, by a ValueError or TypeError that names it.

A process tries them one after the other. It is ended, and its case lost, if it says nothing for `PATIENCE` seconds.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.robustness.bad_arguments.kinds import Case, complaint
from tests.robustness.bad_arguments.table import cases
from tests.robustness.record import record

SECONDS = 2.0  # of processor time, so that other work on the machine does not count
GROWTH = 10**9  # bytes
PATIENCE = 30.0  # s of the clock
_PEAK = Path("/proc/self/clear_refs")  # writing 5 forgets the peak of the memory


def main() -> int:
    """Try all; return 1 if one was not refused as it should be."""
    begun, count, bad, lost = time.monotonic(), len(cases()), 0, 0
    process = _start()
    for index in range(count):
        answer = _ask(process, index)
        if answer is None:
            process.kill()
            lost += 1
            print(f"{cases()[index]}: the process hung or ended", flush=True)
            process = _start()
        elif answer:
            bad += 1
            print(answer, flush=True)
    process.kill()
    promise = "a bad argument is refused in one line, within 2 s and 1 GB"
    record("arguments", promise, count, count - bad - lost, lost, time.monotonic() - begun)
    return int(bad + lost > 0)


def _start() -> subprocess.Popen[str]:
    command = [sys.executable, "-W", "ignore", "-m", "tests.robustness.arguments", "worker"]
    environment = {**os.environ, "JAX_PLATFORMS": "cpu", "IPHYRE_JAX_CONFIGURE": "off"}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, text=True, env=environment, **pipes)  # type: ignore[call-overload]
    _ask(process, -1, 10 * PATIENCE)  # all is imported
    return process  # type: ignore[no-any-return]


def _ask(process: subprocess.Popen[str], index: int, patience: float = PATIENCE) -> str | None:
    """Return what was wrong with a case, empty if nothing was; None if the process does not answer."""
    assert process.stdin is not None
    assert process.stdout is not None
    alarm = threading.Timer(patience, process.kill)
    alarm.start()
    try:
        process.stdin.write(f"{index}\n")
        process.stdin.flush()
        line = process.stdout.readline()
    except BrokenPipeError:
        return None
    finally:
        alarm.cancel()
    return str(json.loads(line)) if line else None


def work() -> None:
    """Try the cases whose numbers come in, and write what was wrong with each."""
    known, answers = cases(), os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a call prints is no answer
    complaint(known[-1])  # the command line imports all that it needs at its first call
    for line in sys.stdin:
        index = int(line)
        print(json.dumps("" if index < 0 else _try(known[index])), file=answers, flush=True)


def _try(case: Case) -> str:
    before = _memory("VmRSS")
    if _PEAK.exists():
        _PEAK.write_text("5")
    begun = time.process_time()
    problem = complaint(case)
    seconds, growth = time.process_time() - begun, _memory("VmHWM") - before
    if seconds > SECONDS:
        problem = problem or f"{case}: took {seconds:.1f} s"
    if growth > GROWTH:
        problem = problem or f"{case}: took {growth / 1e9:.1f} GB"
    return problem


def _memory(field: str) -> int:
    """Return a figure of this process, bytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{field}:"))


if __name__ == "__main__":
    if sys.argv[1:] == ["worker"]:
        work()
    else:
        sys.exit(main())

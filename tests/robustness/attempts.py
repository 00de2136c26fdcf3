"""Attempts of a person: cut files, full disks and killed writers lose none that was confirmed. A minute.

    cut        the file of attempts ends at any byte of its last lines, as after a kill or a power cut
    full disk  the disk is full at any byte of an attempt: the system's own limit of a file's size, and errors of a disk
    kill       SIGKILL hits a process that saves attempts, at a random moment

After each fault the file is opened as the play page opens it, and another attempt is saved. Every attempt that was
confirmed, and only what was confirmed, must be there.
"""

from __future__ import annotations

import errno
import os
import random
import resource
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from record import record

from iphyre_jax import load_scene
from iphyre_jax.viewer.play.guard import RefusedError
from iphyre_jax.viewer.play.session import Session
from iphyre_jax.viewer.plays import append_play, iter_plays, read_plays
from iphyre_jax.viewer.recording import Recording
from iphyre_jax.viewer.sheets import start_of

LINES = 3  # that are cut
KILLS = 40
PART = 16  # bytes that a killed writer writes at once, so that kills hit half lines

WRITER = f"""
import os, sys, time
from pathlib import Path
from iphyre_jax.viewer.plays import append_play
write = os.write
def write_part(handle, content):
    time.sleep(0.001)
    return write(handle, content[:{PART}])
os.write = write_part
for number in range(int(sys.argv[2]), 10**6):
    line = {{"schema": "iphyre_jax/play", "version": 1, "agent": "you", "scene": "hole", "plan": [-1, -1, -1, number]}}
    append_play(Path(sys.argv[1]), line)
    write(1, b"%d\\n" % number)
"""


@contextmanager
def quiet() -> Iterator[list[warnings.WarningMessage]]:
    """Collect warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield caught


def attempt() -> Recording:
    """Return a play that needs no simulator."""
    return start_of(load_scene("hole"))


def cut(folder: Path) -> tuple[int, int, int]:
    """Cut a file at every byte of its last lines."""
    file, good = folder / "cut.jsonl", folder / "good.jsonl"
    session = Session(good)
    for _ in range(LINES):
        session.add(attempt())
    whole = good.read_bytes()
    ends = [end for end, byte in enumerate(whole) if byte == 10]
    tried = survived = lost = 0
    for length in range(len(whole)):
        file.write_bytes(whole[:length])
        kept = sum(end <= length for end in ends)  # a line that lacks only its line break is whole
        torn = length > 0 and length not in ends and whole[length - 1] != 10
        with quiet() as caught:
            Session(file).add(attempt())
        there = len(read_plays(file))
        tried += 1
        survived += there == kept + 1 and len(caught) == torn
        lost += max(0, kept + 1 - there)
    return tried, survived, lost


def full_disk(folder: Path) -> tuple[int, int, int]:
    """Let the disk be full at every third byte of an attempt, in two ways; then let it have room again."""
    file = folder / "full.jsonl"
    session = Session(file)
    session.add(attempt())
    before = file.read_bytes()
    tried = survived = lost = 0
    for way in (limited_size, failing_disk):
        for room in range(0, len(before), 3):
            session = Session(file)
            with way(len(before), room):
                told = refused(lambda: session.add(attempt()))  # noqa: B023 - called at once
            same = file.read_bytes() == before
            left = session.add(attempt())["left"]
            there = len(read_plays(file))
            tried += 1
            survived += told and same and left == session.limit - 1 and there == 2
            lost += max(0, 2 - there)
            file.write_bytes(before)
    return tried, survived, lost


def refused(save: Callable[[], object]) -> bool:
    """Return whether the player is told that an attempt was not saved."""
    try:
        save()
    except RefusedError as refusal:
        return "not saved" in str(refusal)
    return False


@contextmanager
def limited_size(length: int, room: int) -> Iterator[None]:
    """Let the system write so many bytes behind so many others, and no more."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (length + room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextmanager
def failing_disk(length: int, room: int) -> Iterator[None]:
    """Let a disk take so many bytes, in one part, and then fail."""
    del length
    write, left = os.write, [room]

    def full(handle: int, content: bytes) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        count = write(handle, content[: left[0]])
        left[0] -= count
        return count

    with mock.patch("os.write", full):
        yield


def kill(folder: Path) -> tuple[int, int, int, int]:
    """Kill writers at random moments; each goes on in the file of the one before. Also returns the torn tails met."""
    file, rng, confirmed = folder / "killed.jsonl", random.Random(0), []  # noqa: S311 - nothing secret
    survived = lost = torn = 0
    for _ in range(KILLS):
        begin = confirmed[-1] + 2 if confirmed else 0  # the next may be there: killed after the write, before its word
        writer = subprocess.Popen([sys.executable, "-c", WRITER, file, str(begin)], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        said = writer.stdout.readline()
        time.sleep(rng.uniform(0.0, 0.1))
        writer.kill()
        said += writer.stdout.read()
        writer.wait()
        confirmed += [int(number) for number in said.split(b"\n")[:-1]]
        torn += not file.read_bytes().endswith(b"\n")
        with quiet():
            Session(file)
            there = [play.plan[3] for play in iter_plays(file)]
        missing = len(set(confirmed) - set(there))
        survived += not missing and len(set(there)) == len(there) <= len(confirmed) + KILLS
        lost = max(lost, missing)
    append_play(file, {"schema": "iphyre_jax/play", "version": 1, "agent": "you", "scene": "hole", "plan": [-1] * 4})
    lost += len(set(confirmed) - {play.plan[3] for play in iter_plays(file)})
    return KILLS, survived, lost, torn


def main() -> int:
    """Run the three; 0 if nothing was lost."""
    folder = Path("build/test-attempts")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    begin, good = time.monotonic(), True
    for name, promise, check in (
        ("attempts-cut", "a file of attempts that ends anywhere keeps every whole line, and the next one", cut),
        ("attempts-full-disk", "an attempt is saved whole, or the player is told and the file is as before", full_disk),
        ("attempts-kill", "no confirmed attempt is lost when the process is killed", kill),
    ):
        begin = time.monotonic()
        tried, survived, lost, *torn = check(folder)
        record(name, promise, tried, survived, lost, time.monotonic() - begin)
        if torn:
            print(f"{name}: {torn[0]} of the kills left half a line")
        good &= tried == survived and not lost
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

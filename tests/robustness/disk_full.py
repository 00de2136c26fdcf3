"""Part of `make test-faults`: a disk that is full from each write of a run on, and files that cannot grow. Minutes.

A tiny run is trained again and again. Each time the disk is full from one write on, from the first to the last; or no
file may become longer than some size, which also stops what compiled code writes, in mid-write. The run must end with
one line that names its folder. Once there is room again it must go on to the same bits and lines. How often a run
writes varies by a few; a run that ended before its disk was full does not count.
"""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from pathlib import Path

from failing_disk import FailingDisk, files_of_at_most
from kill import same
from record import record
from rich.console import Console

from iphyre_jax.files import LOCK
from iphyre_jax.train import loop
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, runs

CONFIG = TrainConfig(
    games=("support", "hole"),
    hidden_sizes=(16,),
    updates=2,
    episodes_per_scene=8,
    checkpoint_seconds=0.0,
    learner=PPO(minibatches=2),
)
SIZES = (0, 1, 10, 100, 300, 1_000, 2_000, 3_000, 5_000, 10_000, 15_000, 20_000, 30_000)  # bytes; all end a run
QUIET = Console(quiet=True)


def survives(folder: Path, undisturbed: Path, fault: contextlib.AbstractContextManager[None]) -> tuple[bool, bool]:
    """Train with a fault, then go on without; whether all was as promised, and whether a checkpoint was lost."""
    said = ""
    try:
        with fault:
            loop.train(CONFIG, folder, QUIET)
    except OSError as error:
        said = str(error)
    left = [entry.name for entry in folder.rglob("*") if ".part" in entry.name or entry.name == LOCK]
    fine = str(folder) in said and "\n" not in said and not left
    if not fine:
        print(f"{folder.name}: said {said!r}, left {left}", flush=True)
    saved = checkpoint.names(folder)
    try:
        _ = loop.resume(folder, QUIET) if (folder / runs.CONFIG).is_file() else loop.train(CONFIG, folder, QUIET)
        whole = same(folder, undisturbed)
    except (OSError, ValueError) as error:
        print(f"{folder.name}: {error}", flush=True)
        whole = False
    return fine and whole, bool(saved) and not whole


def main() -> int:
    """Fill the disk, train, make room, go on, compare; 0 if every run survived."""
    root, begun = Path("build/test-disk-full").absolute(), time.monotonic()
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    disk = FailingDisk()
    undisturbed = root / "undisturbed"
    loop.train(CONFIG, undisturbed, QUIET)  # compiles
    with disk.failing(root):
        loop.train(CONFIG, root / "counted", QUIET)
    faults = {f"write-{k:03d}": disk.failing(root, k) for k in range(disk.writes)}
    faults |= {f"size-{size}": files_of_at_most(size) for size in SIZES}
    found = []
    for name, fault in faults.items():
        disk.failed = False
        result = survives(root / name, undisturbed, fault)
        if disk.failed or name.startswith("size"):
            found.append(result)
        shutil.rmtree(root / name, ignore_errors=True)
    survived, lost = (sum(each) for each in zip(*found, strict=True))
    promise = "a run on a full disk ends with one line and resumes to the same bits"
    record("disk-full", promise, len(found), survived, lost, time.monotonic() - begun)
    return 0 if survived == len(found) and not lost else 1


if __name__ == "__main__":
    sys.exit(main())

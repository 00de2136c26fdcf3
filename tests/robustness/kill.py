"""`make test-kill`: runs that are killed at random moments and resumed end as if they had not been. Minutes.

Each run is killed with SIGKILL again and again: half of the times while it saves a checkpoint, which it does after
every update, else after a random wait. Then it is resumed once more, to its end. Its last checkpoint must hold the same
bits as that of a run that was never disturbed, and its metrics.csv the same lines, except for the timing columns.
"""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
from record import record

from iphyre_jax.train import trainer
from iphyre_jax.train.storage import checkpoint, logs, runs

KILLS = 40
SAVING = 20  # of them, at least, with a checkpoint half written or half removed
KILLS_OF_A_RUN = 5
LONGEST_SAVE = 0.3  # s, from the first file of a checkpoint to the kill
GAMES = ("support", "hole")
COMMON = ["--preset", "quick", "--games", *GAMES, "--hidden-sizes", "16", "--checkpoint-seconds", "0"]
COMMON += ["--updates", "30", "--episodes-per-scene", "8", "--sampled-episodes", "1"]
SETTINGS = {
    "ppo": ["--minibatches", "2"],
    "sac": ["--warmup", "64", "--gradient-steps", "4", "--buffer-size", "256"],
}


def command(agent: str, folder: Path) -> list[str]:
    """Train, or go on if there is something to go on with."""
    begun = (folder / runs.CONFIG).is_file()
    if not begun:
        shutil.rmtree(folder, ignore_errors=True)  # killed before it had a name for anything
    start = ["train", "--agent", agent, "--out", str(folder), *COMMON, *SETTINGS[agent]]
    return [sys.executable, "-m", "iphyre_jax", *(["resume", str(folder)] if begun else start), "--no-evaluate"]


def updates(folder: Path) -> int:
    """Updates in metrics.csv."""
    return len(logs.read(folder)) if (folder / logs.FILE).is_file() else 0


def newest(folder: Path) -> int:
    """Number of the newest checkpoint, 0 without one."""
    return int(checkpoint.names(folder)[-1]) if checkpoint.names(folder) else 0


def half_done(folder: Path) -> set[str]:
    """Checkpoints that are being written or removed."""
    return {entry.name for entry in (folder / checkpoint.FOLDER).glob(".*")}


def kill_once(agent: str, folder: Path, rng: random.Random, *, saving: bool) -> tuple[bool, bool, bool]:
    """Start or resume a run and kill it: in the middle of its next checkpoint, or some time after its next update.

    Returns:
        Whether it was killed before its end, whether while saving, and whether the checkpoints are still there.
    """
    lines, old = updates(folder), half_done(folder)
    process = subprocess.Popen(command(agent, folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not (half_done(folder) - old if saving else updates(folder) > lines):
        time.sleep(0.001)
    time.sleep(rng.uniform(0.0, LONGEST_SAVE if saving else 2.0))
    before = newest(folder)
    process.send_signal(signal.SIGKILL)
    killed = process.wait() == -signal.SIGKILL
    return killed, killed and bool(half_done(folder) - old), newest(folder) >= before


def same(folder: Path, undisturbed: Path) -> bool:
    """Whether two runs end with the same bits and the same lines."""
    states = [runs.load(path, to_resume=True)[1] for path in (folder, undisturbed)]
    plain = [jax.tree.leaves(state._replace(key=jax.random.key_data(state.key))) for state in states]
    bits = all(np.array_equal(one, other) for one, other in zip(*plain, strict=True))
    lines = [
        [{k: v for k, v in line.items() if k not in trainer.TIMING_COLUMNS} for line in logs.read(path)]
        for path in (folder, undisturbed)
    ]
    return bits and lines[0] == lines[1] and int(states[0].update) == int(states[1].update)


def kill_run(agent: str, folder: Path, rng: random.Random, *, saving: bool) -> tuple[int, int, int]:
    """Kill a run some times; the number of kills, of those while saving, and of lost checkpoints."""
    tries = [kill_once(agent, folder, rng, saving=saving) for _ in range(KILLS_OF_A_RUN)]
    killed, in_save, kept = zip(*tries, strict=True)
    return sum(killed), sum(in_save), len(kept) - sum(kept)


def main() -> int:
    """Kill, resume, compare; 0 if every kill was survived."""
    root, begun = Path("build/test-kill"), time.monotonic()
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    rng = random.Random(0)  # noqa: S311 - nothing secret
    killed = survived = in_save = lost = number = 0
    for agent in SETTINGS:
        subprocess.run(command(agent, root / f"{agent}-undisturbed"), check=True, stdout=subprocess.DEVNULL)
    while killed < KILLS or in_save < SAVING:
        agent = list(SETTINGS)[number // 2 % len(SETTINGS)]
        folder = root / f"{agent}-{number:02d}"
        kills, saves, gone = kill_run(agent, folder, rng, saving=number % 2 == 0 or killed >= KILLS)
        done = subprocess.run(command(agent, folder), check=False, stdout=subprocess.DEVNULL)
        fine = done.returncode == 0 and same(folder, root / f"{agent}-undisturbed")
        print(f"{agent}: {kills} kills, {saves} while saving: {'the same' if fine else 'NOT THE SAME'}", flush=True)
        killed, in_save, lost, number = killed + kills, in_save + saves, lost + gone, number + 1
        survived += kills if fine else 0
    promise = f"a killed run resumes to the same bits and lines; {in_save} kills were while saving"
    record("run-killed", promise, killed, survived, lost, time.monotonic() - begun)
    return 0 if survived == killed and not lost else 1


if __name__ == "__main__":
    sys.exit(main())

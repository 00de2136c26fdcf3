"""`make test-kill`: runs that are killed at random moments and resumed end as if they had not been. Minutes.

Each run is killed with SIGKILL again and again, each time after a random wait, also while it saves (there is a
checkpoint after every update). Then it is resumed once more, to its end. Its last checkpoint must hold the same bits as
that of a run that was never disturbed, and its metrics.csv the same lines, except for the timing columns.
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

from iphyre_jax.train import trainer
from iphyre_jax.train.storage import checkpoint, logs, runs

KILLS = 20
GAMES = ("support", "hole")
COMMON = ["--games", *GAMES, "--hidden-sizes", "16", "--checkpoint-seconds", "0", "--sampled-episodes", "1"]
SETTINGS = {
    "ppo": ["--updates", "40", "--episodes-per-scene", "8", "--minibatches", "2"],
    "sac": [
        "--updates",
        "40",
        "--episodes-per-scene",
        "8",
        "--warmup",
        "64",
        "--gradient-steps",
        "4",
        "--buffer-size",
        "256",
    ],
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


def kill_once(agent: str, folder: Path, rng: random.Random) -> str:
    """Start or resume a run and kill it: at once, or so long after its first new update; says where it was."""
    before, wait = updates(folder), rng.uniform(0.0, 2.0)
    process = subprocess.Popen(command(agent, folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and updates(folder) <= before:
        time.sleep(0.01)
    time.sleep(wait)
    ended = process.poll() is not None
    process.send_signal(signal.SIGKILL)
    process.wait()
    left = [entry.name for entry in (folder / checkpoint.FOLDER).glob(".*")]
    return f"{updates(folder)} updates{', already over' if ended else ''}{', while saving' if left else ''}"


def same(folder: Path, undisturbed: Path) -> bool:
    """Whether two runs end with the same bits and the same lines."""
    states = [runs.load(path)[1] for path in (folder, undisturbed)]
    plain = [jax.tree.leaves(state._replace(key=jax.random.key_data(state.key))) for state in states]
    bits = all(np.array_equal(one, other) for one, other in zip(*plain, strict=True))
    lines = [
        [{k: v for k, v in line.items() if k not in trainer.TIMING_COLUMNS} for line in logs.read(path)]
        for path in (folder, undisturbed)
    ]
    return bits and lines[0] == lines[1] and int(states[0].update) == int(states[1].update)


def main() -> int:
    """Kill, resume, compare; 0 if every kill was survived."""
    root = Path("build/test-kill")
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir(parents=True)
    rng, killed, good = random.Random(0), 0, True  # noqa: S311 - nothing secret
    for agent in SETTINGS:
        subprocess.run(command(agent, root / f"{agent}-undisturbed"), check=True, stdout=subprocess.DEVNULL)
    while killed < KILLS:
        agent = list(SETTINGS)[killed // 2 % len(SETTINGS)]
        folder = root / f"{agent}-{killed:02d}"
        where = [kill_once(agent, folder, rng) for _ in range(min(2, KILLS - killed))]
        killed += len(where)
        done = subprocess.run(command(agent, folder), check=False, stdout=subprocess.DEVNULL)
        fine = done.returncode == 0 and same(folder, root / f"{agent}-undisturbed")
        print(f"{agent}: killed at {'; '.join(where)}: {'the same' if fine else 'NOT THE SAME'}", flush=True)
        good &= fine
    print(f"{killed} kills, {'all' if good else 'NOT all'} resumed to the same bits and the same lines")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

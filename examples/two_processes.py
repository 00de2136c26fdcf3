"""One batch of plans, simulated by two processes, each on half of it.

    python examples/two_processes.py

Both make the same call and get the whole result, with the bits of one process. Here they are started on one machine; on
several hosts start `worker` on each with the address of the first. Accelerators need nothing else: a process shows its
own in `jax.local_devices()`, all of them are in the mesh.
"""

from __future__ import annotations

import hashlib
import socket
import subprocess
import sys

import jax
import numpy as np

import iphyre_jax

PROCESSES, DEVICES = 2, 1  # CPU devices in each process
GAMES = ("hole", "support", "hinder")


def play(mesh: jax.sharding.Mesh | None) -> iphyre_jax.Simulation:
    """Play the same 1000 random plans in every process."""
    rng = np.random.default_rng(0)
    which = rng.integers(len(GAMES), size=1000)
    blocks = np.array([len(iphyre_jax.load_scene(game).eliminable_blocks) for game in GAMES])
    plans = rng.integers(-1, 100, (1000, 6))
    plans[np.arange(6) >= blocks[which][:, None]] = -1
    return iphyre_jax.simulate_many(GAMES, which, plans, fps=10, mesh=mesh)


def digest(played: iphyre_jax.Simulation) -> str:
    """Return a hash of steps and rewards."""
    return hashlib.sha256(played.steps.tobytes() + played.reward.tobytes()).hexdigest()


def worker(address: str, index: int) -> None:
    """Join the others, play and tell."""
    iphyre_jax.configure(devices=DEVICES)
    jax.distributed.initialize(address, PROCESSES, index)
    mesh = jax.make_mesh((jax.device_count(),), ("worlds",))
    played = play(mesh)
    print(index, jax.device_count(), int(played.success.sum()), digest(played), flush=True)


def main() -> int:
    """Start the processes on this machine and wait for them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    commands = [[sys.executable, __file__, address, str(index)] for index in range(PROCESSES)]
    pipe = subprocess.PIPE
    workers = [subprocess.Popen(command, stdout=pipe, text=True) for command in commands]  # noqa: S603 - our own words
    for line in [process.communicate()[0].splitlines()[-1:] for process in workers]:
        print(*line)
    return max((process.returncode for process in workers), key=abs)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.exit(main())
    worker(sys.argv[1], int(sys.argv[2]))

"""`make test-damage`: 200 checkpoints, each damaged in its own way; every one must be refused in one line. A minute."""

from __future__ import annotations

import json
import random
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

from record import record
from rich.console import Console

from iphyre_jax.files import file_sum
from iphyre_jax.train import loop
from iphyre_jax.train.settings.agents import PPO
from iphyre_jax.train.settings.run import TrainConfig
from iphyre_jax.train.storage import checkpoint, manifest, runs

TIMES = 200
CONFIG = TrainConfig(
    games=("support", "hole"),
    hidden_sizes=(16,),
    updates=2,
    episodes_per_scene=8,
    checkpoint_seconds=0.0,
    learner=PPO(minibatches=2),
)


def flip(file: Path, rng: random.Random) -> str:
    """One bit anywhere."""
    content = bytearray(file.read_bytes())
    place, bit = rng.randrange(len(content)), rng.randrange(8)
    content[place] ^= 1 << bit
    file.write_bytes(content)
    return f"bit {bit} of byte {place} of {file.name}"


def truncate(file: Path, rng: random.Random) -> str:
    """The end is missing, or everything."""
    length = rng.randrange(file.stat().st_size)
    file.write_bytes(file.read_bytes()[:length])
    return f"{file.name} cut to {length} bytes"


def remove(file: Path, rng: random.Random) -> str:
    """The file is missing."""
    del rng
    file.unlink()
    return f"{file.name} removed"


def other_version(file: Path, rng: random.Random) -> str:
    """The manifest of another format, with a sum that fits."""
    written = next(folder for folder in file.parents if (folder / manifest.MANIFEST).is_file()) / manifest.MANIFEST
    content = json.loads(written.read_text())
    content["format"] = rng.choice([0, manifest.FORMAT + 1, manifest.FORMAT + 2, "2", None])
    written.write_text(json.dumps(content))
    written.with_name(manifest.SUM).write_text(f"{file_sum(written)}\n")
    return f"format {content['format']!r}"


KINDS: tuple[Callable[[Path, random.Random], str], ...] = (flip, flip, truncate, remove, other_version)


def main() -> int:
    """Damage, load, count; 0 if every damaged checkpoint was refused in one line that offers the good one."""
    root, begun = Path("build/test-damage"), time.monotonic()
    shutil.rmtree(root, ignore_errors=True)
    loop.train(CONFIG, root / "good", Console(quiet=True))
    rng, refused, loaded = random.Random(0), 0, 0  # noqa: S311 - nothing secret
    for k in range(TIMES):
        folder = root / "damaged"
        shutil.copytree(root / "good", folder)
        newest = folder / checkpoint.FOLDER / "000002"
        files = sorted(file for file in newest.rglob("*") if file.is_file() and file.stat().st_size)
        said = KINDS[k % len(KINDS)](rng.choice(files), rng)
        try:
            runs.load(folder)
            print(f"{said}: LOADED")
            loaded += 1
        except ValueError as error:
            fine = "\n" not in str(error) and str(newest) in str(error) and "--checkpoint 000001" in str(error)
            refused += fine
            if not fine:
                print(f"{said}: {error}")
        shutil.rmtree(folder)
    promise = "a damaged checkpoint is refused with one line that offers the last good one"
    record("checkpoint-damage", promise, TIMES, refused, loaded, time.monotonic() - begun)
    return 0 if refused == TIMES else 1


if __name__ == "__main__":
    sys.exit(main())

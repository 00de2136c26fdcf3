"""Virtual environments of engines whose requirements clash with ours, created under build/ when first needed."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from benchmarks.worker_pool import ROOT

FOLDER = ROOT / "build" / "benchmarks"
STAMP = "requirements.txt"
REQUIREMENTS = {
    # iphyre imports pygame without requiring it; its step fails on pymunk 7, its in-advance rule on NumPy 2.
    "official": ("iphyre==0.2.3", "pymunk==6.11.1", "numpy<2", "pygame"),
    # jax2d imports chex without requiring it; the same JAX as ours.
    "jax2d": ("jax2d==1.0.2", "chex", f"jax=={version('jax')}"),
}


def python_of(name: str) -> Path:
    """Return the interpreter of an environment; create it if it is missing or outdated.

    Args:
        name: a key of REQUIREMENTS.

    Raises:
        RuntimeError: it cannot be created; one line.
    """
    folder, wanted = FOLDER / name, "\n".join(REQUIREMENTS[name]) + "\n"
    python, stamp = folder / "bin" / "python", folder / STAMP
    if stamp.is_file() and stamp.read_text() == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    _run(name, sys.executable, "-m", "venv", str(folder))
    _run(name, str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *REQUIREMENTS[name])
    stamp.write_text(wanted)
    return python


def _run(name: str, *command: str) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own words
    except OSError as error:
        raise RuntimeError(f"no environment for {name}: {error}") from None
    if done.returncode != 0:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        raise RuntimeError(f"no environment for {name}: {last[0]}")

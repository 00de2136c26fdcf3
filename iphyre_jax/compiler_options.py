"""The compiler options that make the step fast, and the trial that shows whether a jaxlib knows them."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

# Names that begin with "-" go to LLVM, one with "--" is a flag of its own. Nothing else in the project names an option.
# Together, the first two made jaxlib 0.10.2 abort on an older form of our step: whoever changes the step compiles every
# topology under them.
OPTIONS: Mapping[str, str] = {
    # One loop for several results, instead of one loop for each that computes again what they share.
    "xla_cpu_use_multi_output_fusion": "true",
    # A loop that carries less than so many bytes becomes one function, instead of a call for each operation in it. A
    # chunk's play carries up to 2 MiB in float32; with 1 MiB the hardest games run at two thirds of the speed.
    "xla_cpu_small_while_loop_byte_threshold": "4194304",
    # LLVM compares more pairs of arrays before it gives up vectorising a loop with many results.
    "-vectorize-memory-check-threshold": "100000",
    # The widest vectors there are, bits; by default half of what AVX-512 has. No effect on machines without it.
    "--xla_cpu_prefer_vector_width": "512",
}
FLAG = "--xla_backend_extra_options="
VERDICTS = "compiler_options.json"
TRIAL = "import jax; jax.jit(lambda x: x + 1)(1.0).block_until_ready()"
TRIAL_TIME = 120.0  # s


def missing(flags: str) -> dict[str, str]:
    """Return the options that `flags`, a value of XLA_FLAGS, does not name."""
    words = flags.split()
    lists = [word.removeprefix(FLAG).split(",") for word in words if word.startswith(FLAG)]
    named = {option.partition("=")[0] for option in (*words, *(option for options in lists for option in options))}
    return {name: value for name, value in OPTIONS.items() if name not in named}


def flag(options: Mapping[str, str]) -> str:
    """Return the options as words of XLA_FLAGS; XLA adds up several lists of extra options."""
    settings = [f"{name}={value}" for name, value in options.items()]
    extra = ",".join(setting for setting in settings if not setting.startswith("--"))
    return " ".join(
        [*([FLAG + extra] if extra else []), *(setting for setting in settings if setting.startswith("--"))]
    )


def accepted(options: Mapping[str, str], folder: Path | None) -> bool:
    """Whether a process of this jaxlib survives the options.

    Args:
        options: name -> value.
        folder: where verdicts are remembered; None: nowhere, each call costs a trial of about a second.
    """
    word = flag(options)
    key = f"jaxlib {version('jaxlib')}, {platform.machine()}, {word}"
    verdicts = _read(folder)
    if key in verdicts:
        return verdicts[key]
    verdict = _survives(word)
    # A trial may fail for other reasons than the options: only a verdict with a cause is worth remembering.
    if folder is not None and (verdict or _survives("")):
        _write(folder, {**verdicts, key: verdict})
    return verdict


def _survives(flags: str) -> bool:
    """Whether JAX compiles something on the CPU under these XLA_FLAGS."""
    around = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter and words
            [sys.executable, "-P", "-c", TRIAL], env=around, capture_output=True, check=False, timeout=TRIAL_TIME
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _read(folder: Path | None) -> dict[str, bool]:
    """Return the verdicts so far; a file that cannot be read is as good as none."""
    try:
        found = json.loads((folder / VERDICTS).read_text(encoding="utf-8")) if folder else {}
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) and all(isinstance(value, bool) for value in found.values()) else {}


def _write(folder: Path, verdicts: Mapping[str, bool]) -> None:
    """Keep the verdicts, in one move, for other processes may read or write them now."""
    draft = folder / f"{VERDICTS}.{os.getpid()}"
    try:
        draft.write_text(json.dumps(verdicts, indent=1) + "\n", encoding="utf-8")
        draft.replace(folder / VERDICTS)
    except OSError:
        draft.unlink(missing_ok=True)

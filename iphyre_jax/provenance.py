"""Where a result comes from: versions, device, commit; and in which settings two results differ, in words."""

from __future__ import annotations

import json
import platform
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, Final

import jax

import iphyre_jax
from iphyre_jax.checks import one_line, show
from iphyre_jax.execution.configuration import usable_cores

CORE = ("jax", "jaxlib", "numpy")  # packages that decide a result of the simulator
PACKAGES = (*CORE, "flax", "optax", "orbax-checkpoint")  # of an agent
CODE = (".", ":(top)parity", ":(top)benchmarks")  # beside this package, as git names them

_MOST: Final = 3  # settings that a message names
_MOST_SHOWN: Final = 40  # characters of a value


def versions(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """Return the versions of this package, of Python and of other packages."""
    named = {name: metadata.version(name) for name in packages}
    return {"iphyre_jax": iphyre_jax.__version__, "python": platform.python_version(), **named}


def processor() -> str:
    """Return the processor's name, which `platform` does not know on Linux."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def machine() -> dict[str, Any]:
    """Return system, processor and cores that this process may use, as JSON values."""
    return {"system": platform.platform(), "processor": processor(), "cores": usable_cores()}


def device() -> str:
    """Return the platform and kind of the first device of JAX."""
    first = jax.devices()[0]
    return f"{first.platform}: {first.device_kind}"


def provenance(packages: Sequence[str] = PACKAGES) -> dict[str, Any]:
    """Versions of some packages, device, processors and commit, as JSON values; it goes into every result."""
    return {
        "versions": versions(packages),
        "device": device(),
        "machine": f"{platform.system()} {platform.machine()}, {usable_cores()} cores",
        "commit": source_commit(),
    }


def provenance_facts() -> dict[str, str | None]:
    """`provenance` for the lines of a document: what has parts is JSON."""
    return {name: json.dumps(value) if isinstance(value, dict) else value for name, value in provenance().items()}


def made_by(facts: Mapping[str, object]) -> str:
    """Return the part of a document that says how it was made, in Markdown; facts: as of `provenance_facts`."""
    return "\n\n".join(("## Made by", "\n".join(f"* {name}: {value}" for name, value in facts.items())))


def source_commit() -> str | None:
    """Commit of the checkout that this package is imported from, with "+changes" if its code was edited since.

    The code is the package and the folders `parity` and `benchmarks` of the checkout. None for a package that was
    installed, even if it was installed somewhere inside another checkout.
    """
    source = Path(iphyre_jax.__file__)
    if _git(source, "ls-files", "--error-unmatch", source.name) is None:
        return None
    commit = _git(source, "rev-parse", "HEAD")
    changes = _git(source, "status", "--porcelain", "--untracked-files=no", "--", *CODE)
    return f"{commit}+changes" if commit and changes else commit


def _git(source: Path, *arguments: str) -> str | None:
    """What git prints, run beside `source`; None if there is no git or it refuses."""
    git = shutil.which("git")
    if git is None:
        return None
    command = [git, "-C", str(source.parent), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603 - our own arguments
    return done.stdout.strip() if done.returncode == 0 else None


def flat(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings, those of objects within under their own names: no two are alike."""
    out: dict[str, Any] = {}
    for key, value in settings.items():
        out |= flat(value) if isinstance(value, Mapping) else {key: value}
    return out


def in_words(value: object) -> str:
    """A setting as it is given on the command line: the entries of a list with blanks between them, or "none"."""
    if isinstance(value, list | tuple):
        return " ".join(map(in_words, value)) or "none"
    return "none" if value in (None, "") else value if isinstance(value, str) else show(value)


def differences(found: object, wanted: Mapping[str, Any]) -> str:
    """How settings that were found differ from those that are wanted: "fps 10, not 60; seed 1, not 0"."""
    if not isinstance(found, Mapping):
        return show(found)
    one, other = flat(found), flat(wanted)
    names = [name for name in {**one, **other} if _plain(one.get(name)) != _plain(other.get(name))]
    parts = [f"{name} {_short(one.get(name))}, not {_short(other.get(name))}" for name in names]
    return "; ".join([*parts[:_MOST], *([f"and {len(parts) - _MOST} more"] if len(parts) > _MOST else [])])


def _short(value: object) -> str:
    text = one_line(in_words(value))
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."


def _plain(value: object) -> object:
    """A value as JSON keeps it."""
    return list(map(_plain, value)) if isinstance(value, list | tuple) else value

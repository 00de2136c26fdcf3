"""`configure`: what holds for the whole process, set on request before JAX starts.

The options below are worth several times the speed, but JAX reads them once, when it makes its CPU client. They are
options of the compiler, not of the physics: results are those of the same program compiled otherwise.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

from iphyre_jax.compiler_options import accepted, flag, missing
from iphyre_jax.private_folder import private_folder

CACHE_VARIABLE = "IPHYRE_JAX_CACHE"
OFF_WORDS = ("0", "off", "no", "false")
SHORTEST_COMPILATION = 0.1  # s: quicker ones are not worth a file; JAX's own limit, 1 s, leaves out half of ours
COST = "steps may take several times as long"
DEVICE_COUNT_FLAG = "--xla_force_host_platform_device_count"


@dataclass(frozen=True)
class Configuration:
    """What `configure` has reached.

    Attributes:
        threads: chunks of worlds that are played side by side, while one more is made ready or collected.
        cache: folder of compiled programs, or None if none is kept.
        xla_flags: `XLA_FLAGS` as it is now.
    """

    threads: int
    cache: Path | None
    xla_flags: str


_threads: int | None = None  # as configured; None: one for each usable core
_own_cache: Path | None = None  # the folder that `configure` has given to JAX, if it has


def usable_cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Number of threads that play chunks of worlds."""
    return _threads or usable_cores()


def configure(
    *, devices: int | None = None, cache: bool | str | PathLike[str] | None = None, options: bool = True
) -> Configuration:
    """Set compiler options, number of devices and compilation cache for this process, before JAX starts.

    Compiler options go into `XLA_FLAGS`, behind what the variable holds and without those that it names already. They
    are tried in a subprocess first, once for each jaxlib, because a compiler that does not know one ends the process;
    the verdict is remembered in the cache folder. If JAX has started already, what exists is used, and one warning says
    what that costs. Import alone sets nothing.

    Args:
        devices: threads that play chunks of worlds, and CPU devices that JAX shows (for `simulate(..., mesh=...)`). By
            default one thread for each core this process may use, and JAX's own number of devices.
        cache: folder in which compiled programs are kept between processes, made with mode 0700; False for none. By
            default the environment variable IPHYRE_JAX_CACHE (a folder, or "off"), else `iphyre_jax` in the user's
            cache folder (XDG_CACHE_HOME or ~/.cache), unless JAX has been given a cache folder already.
        options: False leaves the compiler options as they are.

    Returns:
        What holds now.

    Raises:
        ValueError: one line that names the argument and what was expected, also for a cache folder that others own
            or may write.
    """
    global _threads
    if devices is not None and (isinstance(devices, bool) or not isinstance(devices, int) or devices < 1):
        raise ValueError(f"devices: expected a whole number of at least 1, got {devices!r}")
    problems: list[str] = []
    folder = _folder(cache, problems)
    if options:
        _set_options(folder, problems)
    if devices is not None:
        _set_devices(devices, problems)
    _set_cache(folder, keep_foreign=cache is None and not os.environ.get(CACHE_VARIABLE))
    _threads = devices
    if problems:
        warnings.warn("configure: " + "; ".join(problems), RuntimeWarning, stacklevel=2)
    kept = _kept()
    return Configuration(threads(), Path(kept) if kept else None, os.environ.get("XLA_FLAGS", ""))


def _runs() -> bool:
    """Whether JAX has made its clients; it has no public way to ask without making them."""
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def _kept() -> str | None:
    """Return the folder in which JAX keeps compiled programs."""
    return jax.config.values["jax_compilation_cache_dir"] or None


def _folder(cache: bool | str | PathLike[str] | None, problems: list[str]) -> Path | None:
    """Return the private folder to use; a default one that cannot be used is a problem, not an error."""
    if cache is None:
        cache = os.environ.get(CACHE_VARIABLE) or True
        if isinstance(cache, str) and cache.lower() in OFF_WORDS:
            cache = False
    if cache is False:
        return None
    if cache is not True:
        if not isinstance(cache, str | PathLike):
            raise ValueError(f"cache: expected a folder, True, False or None, got {cache!r}")
        return private_folder(Path(cache).expanduser())
    home = os.environ.get("XDG_CACHE_HOME", "")
    try:
        return private_folder((Path(home) if Path(home).is_absolute() else Path.home() / ".cache") / "iphyre_jax")
    except (ValueError, RuntimeError) as error:  # Path.home() finds no home
        problems.append(f"no compilation cache ({error})")
        return None


def _set_options(folder: Path | None, problems: list[str]) -> None:
    """Add the compiler options that are missing to XLA_FLAGS, if JAX still reads it and the compiler knows them."""
    flags = os.environ.get("XLA_FLAGS", "").strip()
    wanted = missing(flags)
    if not wanted:
        return
    if flags and not flags.startswith("-"):
        problems.append(
            "XLA_FLAGS names a file, compiler options are not added to it; steps may take several times as long"
        )
    elif _runs():
        problems.append(f"JAX has started already, without the compiler options; {COST}; call configure first")
    elif not accepted(wanted, folder):
        problems.append(f"this jaxlib refuses the compiler options; {COST}")
    else:
        os.environ["XLA_FLAGS"] = f"{flags} {flag(wanted)}".strip()


def _set_devices(devices: int, problems: list[str]) -> None:
    """Set the number of CPU devices, unless XLA_FLAGS does."""
    if DEVICE_COUNT_FLAG in os.environ.get("XLA_FLAGS", ""):
        return
    if not _runs():
        jax.config.update("jax_num_cpu_devices", devices)
    elif (have := len(jax.local_devices(backend="cpu"))) != devices:
        problems.append(
            f"jax.shard_map can use {have} CPU device{'s' * (have > 1)}, not {devices}, in a JAX that has started"
        )


def _set_cache(folder: Path | None, *, keep_foreign: bool) -> None:
    """Tell JAX where compiled programs are kept.

    Args:
        folder: None for no cache of ours; one that somebody else has set stays.
        keep_foreign: leave a folder that somebody else has set even if there is one of ours.
    """
    global _own_cache
    now = _kept()
    foreign = now is not None and now != str(_own_cache)
    if foreign and (folder is None or keep_foreign):
        return
    if folder is None and now is None:
        return
    jax.config.update("jax_compilation_cache_dir", None if folder is None else str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST_COMPILATION)
    compilation_cache.reset_cache()  # otherwise a process that has compiled already would not look at the folder
    _own_cache = folder

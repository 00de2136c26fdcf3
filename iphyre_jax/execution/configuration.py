"""Threads, devices and the cache folder of a process, and the options of JAX under which networks learn and play."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import jax
from jax.experimental.compilation_cache import compilation_cache

from iphyre_jax.checks import check_positive, check_whole, show
from iphyre_jax.execution.compilation.cache_folder import CACHE_VARIABLE, OFF_WORDS, default_folder, private_folder

LONGEST_COMPILATION = 1e6  # s
MOST_DEVICES = 1024
SHORTEST_COMPILATION = 0.1  # s; JAX's own limit, 1 s, leaves out many of ours
DEVICE_COUNT_FLAG = "--xla_force_host_platform_device_count"


@dataclass(frozen=True)
class Configuration:
    """The settings that hold after `configure`.

    Attributes:
        threads: cores that play.
        cache: folder of compiled programs, or None without one.
        compile_timeout: s, longest compilation of one program, or None for no limit.
    """

    threads: int
    cache: Path | None
    compile_timeout: float | None


@dataclass
class _Settings:
    """The settings of this process."""

    threads: int | None = None  # None: one for each usable core
    folder: Path | None = None
    folder_is_known: bool = False
    compile_timeout: float | None = None
    jax_folder: Path | None = None  # the folder that `configure` has given to JAX, if it has


_settings = _Settings()


def usable_cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Return the number of threads that play groups of worlds."""
    return _settings.threads or usable_cores()


def compile_timeout() -> float | None:
    """Return the longest compilation of one program, s; None for no limit."""
    return _settings.compile_timeout


def cache_folder() -> Path | None:
    """Return the folder of compiled programs, None without one; warn once if it cannot be used."""
    if not _settings.folder_is_known:
        try:
            _settings.folder = default_folder()
        except ValueError as error:
            warnings.warn(f"compiled programs are not kept ({error})", RuntimeWarning, stacklevel=2)
        _settings.folder_is_known = True
    return _settings.folder


def configure(
    *,
    devices: int | None = None,
    cache: bool | str | PathLike[str] | None = None,
    compile_timeout: float | None = None,
    options: bool | None = None,
) -> Configuration:
    """Set threads, CPU devices, cache folder and time limits of this process.

    It is optional. By default all usable cores play, and the user's cache folder keeps compiled programs. `configure`
    also gives the cache folder to JAX, which then keeps your own programs there too.

    Args:
        devices: number of cores to play on, and of CPU devices that JAX shows if it has not started yet, 1 to 1024. By
            default all usable cores, and JAX's own number of devices.
        cache: folder that keeps compiled programs between processes, made with mode 0700; False for none. By default
            the environment variable IPHYRE_JAX_CACHE (a folder, or "off"), else `iphyre_jax` in the user's cache folder
            (XDG_CACHE_HOME or ~/.cache). JAX keeps a folder that it already has.
        compile_timeout: s, longest compilation of one program, up to 1,000,000; a longer one raises TimeoutError; None
            for no limit.
        options: deprecated, does nothing; compiler options are never set in this process.

    Returns:
        The settings that hold now.

    Raises:
        ValueError: one line that names the argument and what was expected, also for a cache folder that others own
            or may write.
    """
    if devices is not None:
        devices = check_whole("devices", devices, 1, MOST_DEVICES)
    if compile_timeout is not None:
        seconds = "None or a positive number of seconds"
        compile_timeout = check_positive("compile_timeout", compile_timeout, seconds, LONGEST_COMPILATION)
    if options is not None:
        text = "configure(options=...) does nothing any more: compiler options are never set in this process"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
    problems: list[str] = []
    folder = _folder(cache, problems)
    if devices is not None:
        _set_devices(devices, problems)
    _give_to_jax(folder, keep_foreign=cache is None and not os.environ.get(CACHE_VARIABLE))
    _settings.threads, _settings.compile_timeout = devices, compile_timeout
    _settings.folder, _settings.folder_is_known = folder, True
    if problems:
        warnings.warn("configure: " + "; ".join(problems), RuntimeWarning, stacklevel=2)
    return Configuration(threads(), folder, compile_timeout)


def _folder(cache: bool | str | PathLike[str] | None, problems: list[str]) -> Path | None:
    """Return the private folder to use; an unusable default folder is a problem, not an error."""
    if cache is None or cache is True:
        try:
            return default_folder()
        except ValueError as error:
            if os.environ.get(CACHE_VARIABLE):
                raise
            problems.append(f"compiled programs are not kept ({error})")
            return None
    if cache is False or (isinstance(cache, str) and cache.lower() in OFF_WORDS):
        return None
    is_path = isinstance(cache, str | PathLike) and isinstance(os.fspath(cache), str)
    if not is_path or not os.fspath(cache) or "\0" in str(cache):
        raise ValueError(f"cache: expected a folder, True, False or None, got {show(cache)}")
    return private_folder(Path(cache))


def jax_has_started() -> bool:
    """Return whether JAX has made its clients; the public way to ask would make them."""
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def _set_devices(devices: int, problems: list[str]) -> None:
    """Set the number of CPU devices that JAX shows, unless XLA_FLAGS does."""
    if DEVICE_COUNT_FLAG in os.environ.get("XLA_FLAGS", ""):
        return
    if not jax_has_started():
        jax.config.update("jax_num_cpu_devices", devices)
    elif (have := len(jax.local_devices(backend="cpu"))) != devices:
        problems.append(f"JAX has started with {have} CPU device{'s' * (have > 1)} and keeps them, not {devices}")


def _give_to_jax(folder: Path | None, *, keep_foreign: bool) -> None:
    """Give JAX the cache folder for the user's own programs.

    Args:
        folder: ours; None for none. A folder that somebody else has set then stays.
        keep_foreign: whether such a folder stays even if there is one of ours.
    """
    now = jax.config.values["jax_compilation_cache_dir"] or None
    foreign = now is not None and now != str(_settings.jax_folder)
    if foreign and (folder is None or keep_foreign):
        return
    if folder is None and now is None:
        return
    jax.config.update("jax_compilation_cache_dir", None if folder is None else str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", SHORTEST_COMPILATION)
    compilation_cache.reset_cache()  # otherwise a process that has already compiled would ignore the folder
    if folder is not None:
        with contextlib.suppress(ImportError):  # a JAX with other insides keeps its own files there
            from iphyre_jax.execution.compilation.jax_cache import NO_PATHS, set_jax_cache

            jax.config.update("jax_persistent_cache_enable_xla_caches", NO_PATHS)
            set_jax_cache(folder)
    _settings.jax_folder = folder


@contextlib.contextmanager
def default_options() -> Iterator[None]:
    """Work with JAX's defaults of what decides numbers, for this thread: a context, or a decorator of a function.

    So trained networks have the same bits in any user's process. Programs in float64 set x64 around their own calls.
    """
    with (
        jax.enable_x64(False),
        jax.default_prng_impl("threefry2x32"),
        jax.threefry_partitionable(True),
        jax.default_matmul_precision(None),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield

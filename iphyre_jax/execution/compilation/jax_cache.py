"""The user's own programs in our cache folder: JAX's compilation cache, with sound entries.

JAX's own file cache never replaces a damaged entry and writes in place, and its keys hold the folder's path. Here an
entry is one of `cache_folder`: it is checked, replaced in one move, and belongs to processors of the same features.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from jax._src import compilation_cache as internal  # JAX has no public way to set a cache of one's own
from jax._src.compilation_cache_interface import CacheInterface

from iphyre_jax.execution.compilation.cache_folder import JAX_SUFFIX, entry_path, machine, read_entry, write_entry

NO_PATHS: Final = "none"  # of `jax_persistent_cache_enable_xla_caches`: otherwise the folder is part of JAX's keys


class JaxCache(CacheInterface):
    """Entries of JAX in a private folder."""

    def __init__(self, folder: Path) -> None:
        self._path = folder  # JAX reads this attribute

    def get(self, key: str) -> bytes | None:
        """Return an entry; None if it is missing or damaged, so that JAX compiles again and calls `put`."""
        own = _key(key)
        return read_entry(self._entry(own), own)

    def put(self, key: str, value: bytes) -> None:
        """Write an entry in place of an older one."""
        own = _key(key)
        write_entry(self._entry(own), own, value)

    def _entry(self, key: Mapping[str, Any]) -> Path:
        return entry_path(self._path, key).with_suffix(JAX_SUFFIX)


def _key(key: str) -> dict[str, Any]:
    return {"jax": key, "machine": machine()}


def set_jax_cache(folder: Path) -> None:
    """Make JAX keep its programs in a folder, from now on."""
    internal._cache = JaxCache(folder)
    internal._cache_initialized = True

"""The folder that keeps compiled programs between processes.

A compiled program is machine code: whoever can write the folder can run code as this user. So the folder must belong to
this user, and nobody else may write it or its entries. A process checks the folder when it first uses it, and an entry
whenever it reads it. The checksum in an entry detects damage, not malice.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from iphyre_jax.files import replacing
from iphyre_jax.locks import lock_file

CACHE_VARIABLE = "IPHYRE_JAX_CACHE"
OFF_WORDS = ("0", "off", "no", "false")
MAGIC = b"iphyre_jax program\n"
SUFFIX = ".program"
JAX_SUFFIX = ".jax"  # of programs that JAX compiles for the user
ROOM = 1 << 23  # bytes on the disk, more than the entry of a game takes
WAIT = 0.05  # s between checks of another process's claim
KEEP_DAYS = 60.0  # an entry that nobody has read for so long is removed when programs are compiled

# Of entries and their drafts: what else stands in a folder that the user has named is not ours to remove.
_NAME = re.compile(rf"([0-9a-f]{{32}}|\.[0-9a-f]{{32}}\.[0-9a-z]+\.part)({re.escape(SUFFIX)}|{re.escape(JAX_SUFFIX)})")
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def private_folder(folder: Path) -> Path:
    """Return the folder's absolute path, made with mode 0700 if it is missing; "~" is the user's home.

    Raises:
        ValueError: it cannot be made, or somebody else owns it or may write it; one line.
    """
    try:
        folder = folder.expanduser().absolute()  # wherever the process goes from here
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        about = folder.stat()
    except FileExistsError:  # what `mkdir` says of a file in a folder's place
        raise ValueError(f"cache: cannot use {folder}: it, or what it stands in, is no folder") from None
    except OSError as error:
        raise ValueError(f"cache: cannot use {folder}: {error.strerror}") from None
    except RuntimeError as error:  # there is no home folder
        raise ValueError(f"cache: cannot use {folder}: {error}") from None
    if problem := _distrusted(about):
        raise ValueError(f"cache: {problem.format(folder)}; expected a folder of this user with mode 0700")
    return folder


def default_folder() -> Path | None:
    """Return the folder that IPHYRE_JAX_CACHE names, else `iphyre_jax` in the user's cache folder; None if turned off.

    Raises:
        ValueError: see `private_folder`; one line.
    """
    named = os.environ.get(CACHE_VARIABLE, "")
    if named.lower() in OFF_WORDS:
        return None
    if named:
        return private_folder(Path(named))
    home = os.environ.get("XDG_CACHE_HOME", "")
    return private_folder((Path(home) if Path(home).is_absolute() else Path("~/.cache")) / "iphyre_jax")


def entry_path(folder: Path, key: Mapping[str, Any]) -> Path:
    """Return the path of an entry; key: JSON values."""
    return folder / (hashlib.sha256(_canonical(key)).hexdigest()[:32] + SUFFIX)


def read_entry(path: Path, key: Mapping[str, Any]) -> bytes | None:
    """Return the payload of an entry; None if it is missing, damaged, somebody else's, or has another key."""
    try:
        with path.open("rb") as file:
            if _distrusted(os.fstat(file.fileno())) or file.readline() != MAGIC:
                return None
            header, payload = json.loads(file.readline()), file.read()
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(header, dict) or header.get("key") != json.loads(_canonical(key)):
        return None
    if header.get("sha256") != hashlib.sha256(payload).hexdigest():
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # marks it as used
    return payload


@contextlib.contextmanager
def claimed(path: Path) -> Iterator[bool]:
    """Claim an entry while the context lasts; yield False if another process is making it.

    A claim ends with its process. Where files cannot be locked, every process makes its own entry.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(lock_file(path.with_suffix(".lock"), f"{path}: expected an entry"))
            is_ours = True
        except BlockingIOError:
            is_ours = False
        except OSError:
            is_ours = True
        yield is_ours


def wait_for_claim(path: Path, until: float, show: Callable[[], None]) -> bool:
    """Wait until no other process claims an entry, and return whether that came; an interrupt ends the wait.

    Args:
        path: of the entry.
        until: s, on the monotonic clock; then it waits no longer.
        show: called again and again meanwhile.
    """
    while True:
        with claimed(path) as is_free:
            if is_free:
                return True
        if time.monotonic() >= until:
            return False
        show()
        time.sleep(WAIT)


def write_entry(path: Path, key: Mapping[str, Any], payload: bytes) -> None:
    """Write an entry and rename it into place, because other processes may read or write it.

    Raises:
        OSError: it cannot be written.
    """
    header = {"key": key, "sha256": hashlib.sha256(payload).hexdigest()}
    with replacing(path) as draft, open(draft, "wb", opener=_open_private) as file:
        file.write(MAGIC + _canonical(header) + b"\n" + payload)


def check_room(folder: Path) -> None:
    """See that an entry can be written into a folder, before it is compiled.

    Raises:
        OSError: the folder is read-only, or its disk is full.
    """
    with tempfile.TemporaryFile(dir=folder) as file:
        if hasattr(os, "posix_fallocate"):  # not on Windows and macOS
            os.posix_fallocate(file.fileno(), 0, ROOM)


def remove_old_entries(folder: Path) -> None:
    """Remove entries, and drafts of killed processes (with the same suffixes), that nobody has used for KEEP_DAYS."""
    before = time.time() - KEEP_DAYS * 86400
    for path in list(folder.iterdir()):
        try:
            if _NAME.fullmatch(path.name) and path.stat().st_mtime < before:
                path.unlink()
        except OSError:
            continue  # somebody else removed it


@cache
def machine() -> str:
    """Return the system, and a sum of the processor's features: machines that differ in them share no machine code."""
    try:
        return machine_of(Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return machine_of("")


def machine_of(cpuinfo: str) -> str:
    """Return what `machine` says, for the text of /proc/cpuinfo."""
    lines = cpuinfo.splitlines()
    found = next((line.partition(":")[2] for line in lines if line.lower().startswith(("flags", "features"))), "")
    features = " ".join(sorted(found.split())) or platform.processor()
    return f"{sys.platform} {platform.machine()} {hashlib.sha256(features.encode()).hexdigest()[:16]}"


def _open_private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def _canonical(value: Mapping[str, Any]) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def _distrusted(about: os.stat_result) -> str | None:
    """Return why a file or folder cannot be trusted, with {} for its name; None if it can."""
    if not hasattr(os, "geteuid"):  # Windows: the system protects a user's folders
        return None
    if about.st_uid != os.geteuid():
        return "{} belongs to another user"
    return "others may write {}" if about.st_mode & _OTHERS_WRITE else None

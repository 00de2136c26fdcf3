"""Where a data set is written: NAME.npz, NAME.json beside it, and NAME.parts while it is made."""

from __future__ import annotations

import os
import re
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Final

from iphyre_jax.checks import one_line, show
from iphyre_jax.files import check_writable

_HEAD: Final = 200  # bytes of NAME.json that hold its schema


def check_path(path: str | os.PathLike[str], name: str = "path") -> tuple[Path, Path]:
    """Return the two files of a data set, NAME.npz and NAME.json; ValueError, which begins with `name`, for others."""
    if not isinstance(path, str | os.PathLike) or "\0" in str(path) or Path(path).suffix not in (".npz", ".json"):
        got = show(str(path) if isinstance(path, os.PathLike) else path)
        raise ValueError(f"{name}: expected the path of a data set, NAME.npz, got {got}")
    return Path(path).with_suffix(".npz"), Path(path).with_suffix(".json")


def check_target(
    path: str | os.PathLike[str], schema: str, arrays: Collection[str], name: str = "path"
) -> tuple[Path, Path]:
    """Return the files NAME.npz and NAME.json to write, whose manifest has a schema.

    Args:
        path: of NAME.npz or NAME.json.
        schema: of the manifest.
        arrays: names that NAME.npz may have; a kill leaves it without a manifest.
        name: of the argument, for the message.

    Raises:
        ValueError: another path, or a file is there and is something else, such as a scene; one line.
        OSError: a file cannot be read.
    """
    npz, manifest = check_path(path, name)
    if npz.exists() and not manifest.exists() and not _array_names(npz) <= set(arrays):
        raise ValueError(f"{name}: {one_line(str(npz))} is there and is no {schema}; expected another name")
    if manifest.exists():
        with manifest.open("rb") as file:
            head = file.read(_HEAD)
        if not re.match(rb'\{\s*"schema": "' + re.escape(schema.encode()) + b'"', head):
            raise ValueError(f"{name}: {one_line(str(manifest))} is there and is no {schema}; expected another name")
    return npz, manifest


def journal_of_new(path: str | os.PathLike[str], schema: str, arrays: Collection[str], name: str) -> Path:
    """Return NAME.parts, the folder where a command that makes a new data set keeps its journal.

    Args:
        path: of NAME.npz or NAME.json.
        schema: of the manifest.
        arrays: names that NAME.npz may have.
        name: of the argument, for the message.

    Raises:
        ValueError: as for `check_target`, or a data set is there, and no journal of a killed command; one line.
        OSError: a file cannot be read, or none can be written there.
    """
    npz, manifest = check_target(path, schema, arrays, name)
    journal = npz.with_suffix(".parts")
    if npz.exists() and manifest.exists() and not journal.exists():
        raise ValueError(f"{name}: {one_line(str(npz))} is there; expected another name")
    check_writable(npz.parent, name)
    return journal


def _array_names(npz: Path) -> set[str]:
    """Return the names of the arrays in a file; one that no array can have if it holds something else."""
    try:
        with zipfile.ZipFile(npz) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except zipfile.BadZipFile:
        return {""}

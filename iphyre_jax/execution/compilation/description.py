"""Programs as JSON: for the process that compiles them, and in the key of a cache entry.

A description is data: nothing in it is executed, and only dataclasses of this package are made from it.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

PACKAGE = __name__.partition(".")[0]

Json = Any


def describe(value: object) -> Json:
    """Return a dataclass of this package as JSON values; it may nest tuples, numbers, strings and None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        fields = {field.name: describe(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", **fields}
    if isinstance(value, tuple):
        return [describe(part) for part in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"expected a dataclass, a tuple, a number, a string or None, got {value!r}")


def from_description(description: Json) -> Any:  # noqa: ANN401 - whatever was described
    """Return the value that `describe` has described.

    Raises:
        ValueError: it names a class that is not a dataclass of this package.
    """
    if isinstance(description, list):
        return tuple(from_description(part) for part in description)
    if not isinstance(description, dict):
        return description
    module, _, name = str(description.get("class")).partition(":")
    kind: Any = getattr(import_module(module), name, None) if module.partition(".")[0] == PACKAGE else None
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind)):
        raise ValueError(f"class: expected a dataclass of {PACKAGE}, got {description.get('class')!r}")
    return kind(**{name: from_description(part) for name, part in description.items() if name != "class"})


def source_sums(root: Path = Path(__file__).parents[2]) -> dict[str, bytes]:
    """Return the SHA-256 of each file of code in a folder, by default the package's, by its path there."""
    sums = {}
    for path in sorted(root.rglob("*.py")):
        with suppress(FileNotFoundError):  # an editor's link to nowhere, or a file that an update removes
            sums[path.relative_to(root).as_posix()] = hashlib.sha256(path.read_bytes()).digest()
    return sums


_AT_START = source_sums()  # of the code that this process runs, whatever becomes of the files


@cache
def source_sum(parts: tuple[str, ...]) -> str:
    """Return a checksum of files and folders of the package, so that programs of other versions are never used.

    It is that of the files when this process started.
    """
    return sum_of(parts, _AT_START)


def sum_of(parts: tuple[str, ...], sums: Mapping[str, bytes]) -> str:
    """Return the checksum of some files and folders among `source_sums`.

    Raises:
        ValueError: one is not there; one line.
    """
    total = hashlib.sha256()
    for part in parts:
        own = [name for name in sums if name == part or name.startswith(f"{part}/")]
        if not own:
            raise ValueError(f"sources: expected a file or folder of the package's code, got {part}")
        for name in own:
            total.update(name.encode() + sums[name])
    return total.hexdigest()

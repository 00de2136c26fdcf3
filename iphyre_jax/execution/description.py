"""Programs as JSON: what one process tells another to compile, and part of the name of a cache entry.

A description is data: nothing in it is run, and only dataclasses of this package are made from it.
"""

from __future__ import annotations

import dataclasses
from importlib import import_module
from typing import Any

PACKAGE = __name__.partition(".")[0]

Json = Any


def describe(value: object) -> Json:
    """Return a dataclass of this package, nested with tuples, numbers, texts and None, as JSON values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = type(value)
        fields = {field.name: describe(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", **fields}
    if isinstance(value, tuple):
        return [describe(part) for part in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"expected a dataclass, a tuple, a number, a text or None, got {value!r}")


def from_description(description: Json) -> Any:  # noqa: ANN401 - whatever was described
    """Return what `describe` was given.

    Raises:
        ValueError: it names a class that is no dataclass of this package.
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

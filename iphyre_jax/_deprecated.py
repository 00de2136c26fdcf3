"""Old names, which work for one version and warn."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module


def moved(module: str, names: Mapping[str, tuple[str, str]]) -> Callable[[str], object]:
    """Return the `__getattr__` of an old module (PEP 562); names: old name -> new module and new name."""

    def find(name: str) -> object:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        home, new = names[name]
        warnings.warn(f"{module}.{name}: use {home}.{new}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(home), new)

    return find

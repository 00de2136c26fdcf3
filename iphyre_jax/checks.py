"""Checks of public arguments: one line that names the argument and what was expected, before anything is allocated."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

DTYPES = ("float32", "float64")
_MAX_SHOWN = 60  # characters of a value that is shown


def check_whole(name: str, value: Any, least: int = 1, most: int | None = None, unit: str = "") -> int:  # noqa: ANN401
    """Return `value` as an int.

    Args:
        name: of the argument, for the message.
        value: what the caller gave.
        least: smallest value allowed.
        most: largest value allowed; None for no limit.
        unit: of the value, for the message.

    Raises:
        ValueError: it is no integer of that range; one line.
    """
    integer = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not integer or value < least or (most is not None and value > most):
        of_unit = f" of {unit}" if unit else ""
        allowed = f"{of_unit} of at least {least}" if most is None else f"{of_unit} from {least} to {most}"
        raise ValueError(f"{name}: expected a whole number{allowed}, got {value!r}")
    return int(value)


def check_positive(name: str, value: Any, what: str = "a positive number") -> float:  # noqa: ANN401
    """Return `value` as a float; ValueError in one line unless it is positive and finite."""
    if not _is_number(value) or not 0 < value < math.inf:
        raise ValueError(f"{name}: expected {what}, got {value!r}")
    return float(value)


def check_least(name: str, value: Any, least: float) -> float:  # noqa: ANN401
    """Return `value` as a float; ValueError in one line unless it is finite and at least `least`."""
    if not _is_number(value) or not least <= value < math.inf:
        raise ValueError(f"{name}: expected a finite number of at least {least}, got {value!r}")
    return float(value)


def check_option(name: str, value: Any, options: Sequence[str]) -> str:  # noqa: ANN401
    """Return `value`; ValueError in one line unless it is one of the options."""
    if value not in options:
        raise ValueError(f"{name}: expected one of {', '.join(options)}, got {value!r}")
    return str(value)


def check_dtype(value: object) -> str:
    """Return "float32" or "float64"; ValueError in one line for anything else."""
    if value not in DTYPES:
        raise ValueError(f'dtype: expected "float32" or "float64", got {value!r}')
    return str(value)


def whole_fps(fps: object) -> int:
    """Return `fps` as an int; ValueError in one line unless it is a positive whole number (a float may be whole)."""
    if not isinstance(fps, bool) and isinstance(fps, numbers.Real):
        value = float(fps)
        if value > 0 and value.is_integer():  # False for an infinity or a NaN
            return int(value)
    raise ValueError(f"fps: expected a positive whole number of physics steps a second, got {fps!r}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def show(value: object) -> str:
    """Write any value, however large or strange, in one short printable line."""
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, Mapping):
        return f"an object of {len(value)} fields"
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"  # Python refuses to print the largest ones
    text = one_line(repr(value[: 2 * _MAX_SHOWN] if isinstance(value, str) else value))
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."


def one_line(text: str) -> str:
    """Escape line breaks and all other characters that do not print."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

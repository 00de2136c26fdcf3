"""Checks of public arguments: one line that names the argument and what was expected, before anything is allocated."""

from __future__ import annotations

import math
import numbers
import sys
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

DTYPES = ("float32", "float64")
MIN_FPS: Final = 1e-3  # physics steps a second
MAX_FPS: Final = 100_000  # beyond any use: an episode of 15 s has 1.5 million steps, which only one mover may make
MAX_RESETS: Final = 2**31 - 1  # number of the reset of a reused space
MAX_SEED: Final = 2**63 - 1
MAX_SECONDS: Final = 1e7  # s; more than any play may last, at any rate
_LARGEST: Final = sys.float_info.max
_LARGEST_WHOLE: Final = np.iinfo(np.int64).max
_MAX_SHOWN = 60  # characters of a value that is shown

Value = TypeVar("Value")


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
        limit = "" if most is None else f" and at most {most}"
        raise ValueError(f"{name}: expected a whole number{of_unit} of at least {least}{limit}, got {show(value)}")
    return int(value)


def check_positive(name: str, value: Any, what: str = "a positive number", most: float | None = None) -> float:  # noqa: ANN401
    """Return `value` as a float; ValueError in one line unless it is positive, finite and at most `most`."""
    number = _as_float(value)
    if not 0 < number <= (_LARGEST if most is None else most):
        limit = "" if most is None else f" of at most {most:.15g}"
        raise ValueError(f"{name}: expected {what}{limit}, got {show(value)}")
    return number


def check_least(
    name: str,
    value: Any,  # noqa: ANN401
    least: float,
    most: float | None = None,
    what: str = "a finite number",
) -> float:
    """Return `value` as a float; ValueError in one line unless it is finite and from `least` to `most`."""
    number = _as_float(value)
    if not least <= number <= (_LARGEST if most is None else most):
        limit = "" if most is None else f" and at most {most:.15g}"
        raise ValueError(f"{name}: expected {what} of at least {least}{limit}, got {show(value)}")
    return number


def check_real(name: str, value: Any) -> float:  # noqa: ANN401
    """Return `value` as a float, which may be infinite; ValueError in one line unless it is a number."""
    number = _as_float(value)
    if math.isnan(number) or (isinstance(value, int) and math.isinf(number)):
        raise ValueError(f"{name}: expected a number, got {show(value)}")
    return number


def check_flag(name: str, value: object) -> bool:
    """Return `value`; ValueError in one line unless it is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: expected True or False, got {show(value)}")
    return bool(value)


def check_option(name: str, value: Any, options: Sequence[str]) -> str:  # noqa: ANN401
    """Return `value`; ValueError in one line unless it is one of the options."""
    if not isinstance(value, str) or value not in options:
        raise ValueError(f"{name}: expected one of {', '.join(options)}, got {show(value)}")
    return str(value)


def check_instance(name: str, value: Value, kind: Any, what: str) -> Value:  # noqa: ANN401 - a class or a union
    """Return `value`; ValueError in one line that says `what` was expected unless it is of that class."""
    if not isinstance(value, kind):
        raise ValueError(f"{name}: expected {what}, got {show(value)}")
    return value


def is_list(value: object) -> bool:
    """Return whether a value is a sequence or an array, but no text."""
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)


def check_dtype(value: object) -> str:
    """Return "float32" or "float64"; ValueError in one line for anything else."""
    if not isinstance(value, str | np.dtype) or value not in DTYPES:
        raise ValueError(f'dtype: expected "float32" or "float64", got {show(value)}')
    return str(value)


def check_fps(value: Any) -> float:  # noqa: ANN401
    """Return physics steps a second as a float; ValueError in one line unless from MIN_FPS to MAX_FPS."""
    rate = check_positive("fps", value, "a positive number of physics steps a second", MAX_FPS)
    if rate < MIN_FPS:
        raise ValueError(f"fps: expected at least {MIN_FPS:g} physics steps a second, got {show(value)}")
    return rate


def check_resets(value: object) -> int:
    """Return the number of a reset; ValueError in one line unless it is a whole number from 1 to MAX_RESETS."""
    return check_whole("resets", value, 1, MAX_RESETS)


def whole_fps(fps: object) -> int:
    """Return `fps` as an int; ValueError in one line unless it is whole, 1 to MAX_FPS (a float may be whole)."""
    if not isinstance(fps, bool) and isinstance(fps, numbers.Real):
        try:
            value = float(fps)
        except OverflowError:
            value = math.inf
        if 1 <= value <= MAX_FPS and value.is_integer():
            return int(value)
    wanted = f"a positive whole number of physics steps a second, at most {MAX_FPS}"
    raise ValueError(f"fps: expected {wanted}, got {show(fps)}")


def check_integers(
    name: str, value: npt.ArrayLike, what: str, ndim: int, hint: Callable[[object], str] = lambda given: ""
) -> npt.NDArray[np.int64]:
    """Return `value` as an int64 array; unsigned numbers beyond its range become its largest.

    Args:
        name: of the argument, for the message.
        value: what the caller gave; an empty list counts as integers.
        what: what was expected, for the message.
        ndim: number of axes.
        hint: says what to do instead about the array, or about a value that is none, for the message.

    Raises:
        ValueError: another shape or type, or a value that JAX traces; one line.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(f"{name}: expected {what}, got rows of unequal length") from None
    except TypeError:  # JAX's, for a traced value
        raise ValueError(f"{name}: expected {what}, got {show(value)}{hint(value)}") from None
    if array.ndim != ndim or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(f"{name}: expected {what}, got {array.dtype} of shape {array.shape}{hint(array)}")
    if array.dtype == np.uint64:
        array = np.minimum(array, np.uint64(_LARGEST_WHOLE))
    return array.astype(np.int64)


def check_which(
    which: npt.ArrayLike, scenes: int, hint: Callable[[object], str] = lambda given: ""
) -> npt.NDArray[np.int64]:
    """Return `which`, the scene of each plan, as an int64 array.

    Args:
        which: (B,) what the caller gave.
        scenes: how many there are.
        hint: see `check_integers`.

    Raises:
        ValueError: no whole numbers in a row, or no scene's; one line.
    """
    index = check_integers("which", which, "integers, the scene of each plan", 1, hint)
    if index.size and (index.min() < 0 or index.max() >= scenes):
        raise ValueError(f"which: expected indices into {scenes} scenes, got {index.min()} to {index.max()}")
    return index


def cut(numbers: Any, least: int = -(2**31), most: int = 2**31 - 1) -> Any:  # noqa: ANN401 - of NumPy or JAX
    """Return whole numbers of any type as int32, cut to bounds before they are narrowed."""
    return numbers.clip(max(least, 0) if numbers.dtype.kind == "u" else least, most).astype(np.int32)


def check_rows(rows: Any, count: int) -> npt.NDArray[Any]:  # noqa: ANN401
    """Return indices or a mask of `count` rows as an array; ValueError in one line for anything else."""
    index = np.asarray(rows)
    if index.ndim == 1 and not index.size:
        index = index.astype(np.intp)  # an empty list has no type
    is_mask = index.dtype == bool
    if index.ndim != 1 or index.dtype.kind not in "iub" or (is_mask and len(index) != count):
        raise ValueError(f"rows: expected indices or a mask of {count} rows, got {show(rows)}")
    if not is_mask and index.size and (index.min() < -count or index.max() >= count):
        raise ValueError(f"rows: expected indices of {count} rows, got {index.min()} to {index.max()}")
    return index


def check_plans(plans: Any, blocks: int, most: int | None = None) -> npt.NDArray[np.float64]:  # noqa: ANN401
    """Return plans (N, blocks) in seconds, or with up to `most` columns; ValueError in one line for anything else."""
    times = as_floats("plans", plans, "seconds")
    if times.ndim != 2 or not blocks <= times.shape[1] <= (most or blocks):
        raise ValueError(f"plans: expected shape (N, {blocks}), a column for each block, got {times.shape}")
    return times


def as_floats(name: str, values: Any, what: str) -> npt.NDArray[np.float64]:  # noqa: ANN401
    """Return numbers as a float64 array; ValueError in one line that says `what` was expected for anything else."""
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected {what}, got {show(values)}") from None


def _as_float(value: object) -> float:
    """A number as a float, so that no comparison is made in a narrower type; NaN for anything else."""
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # an integer
        return math.inf if value > 0 else -math.inf


def missing_extra(what: str, extra: str, package: str | None) -> ModuleNotFoundError:
    """Return the error, in one line, of what needs a package that an optional extra brings."""
    line = f"{what} needs the extra {extra!r} ({package} is missing): pip install 'iphyre-jax[{extra}]'"
    return ModuleNotFoundError(line, name=package)


def show(value: object) -> str:
    """Write any value, however large or strange, in one short printable line."""
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}"
    if isinstance(value, Mapping):
        return f"an object of {len(value)} fields"
    if isinstance(value, Set):
        return f"a set of {len(value)}"
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of {value.dtype}, shape {value.shape}"
    if isinstance(value, int) and value.bit_length() > 64:
        return f"an integer of {value.bit_length()} bits"  # Python refuses to print the largest ones
    if isinstance(value, (str, bytes, bytearray)):
        value = value[: 2 * _MAX_SHOWN]
    try:
        text = one_line(repr(value))
    except Exception:
        return f"a {type(value).__name__}"
    return text if len(text) <= _MAX_SHOWN else f"{text[: _MAX_SHOWN - 3]}..."


def one_line(text: str) -> str:
    """Escape line breaks and all other characters that do not print."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

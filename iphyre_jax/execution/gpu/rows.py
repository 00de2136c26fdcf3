"""Arrays as rows of numbers, and the operations that only move rows about.

An array of a table's shape, (rows, *lanes), is a NumPy array of objects, one a row: what its lanes have there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, cast

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

LANES: Final = 1_000_003  # of arrays as they are traced; a prime, so that no other axis is as long

# Of the rows' shape. A number is (block,) over lanes, () if all lanes have it, or NumPy's if it is known.
Values = npt.NDArray[np.object_]


def has_lanes(shape: Sequence[int]) -> bool:
    """Return whether a traced array has lanes behind its rows."""
    return bool(shape) and shape[-1] == LANES


def rows_of(shape: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a traced array without lanes."""
    return tuple(shape[:-1]) if has_lanes(shape) else tuple(shape)


def values(shape: Sequence[int], numbers: Sequence[Any]) -> Values:
    """Return numbers as an array of rows."""
    out = np.empty(math.prod(shape), object)
    for k, number in enumerate(numbers):
        out[k] = number
    return out.reshape(tuple(shape))


def known_values(table: npt.ArrayLike) -> Values:
    """Return an array of NumPy as an array of rows."""
    table = np.asarray(table)
    return values(table.shape, list(np.ravel(table)))


def is_known(number: object) -> bool:
    """Return whether a number is known while the function is traced."""
    return isinstance(number, np.generic)


def spread(number: Any, dtype: Any, block: int) -> jax.Array:  # noqa: ANN401
    """Return a number as one of each lane, (block,)."""
    if is_known(number):
        return jnp.full((block,), cast(Any, number), dtype)
    return jnp.broadcast_to(number, (block,))


def _slice(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    params, rows = equation.params, given[0].ndim
    strides = params["strides"] or (1,) * len(params["start_indices"])
    bounds = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return [given[0][tuple(slice(*bound) for bound in bounds)[:rows]]]


def _reshape(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    return [given[0].reshape(rows_of(equation.outvars[0].aval.shape))]


def _concatenate(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    return [np.concatenate(given, equation.params["dimension"])]


def _stack(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    return [np.stack(given, equation.params["axis"])]


def _unstack(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    rows, axis = given[0], equation.params["axis"]
    return [values((), [row]) if rows.ndim == 1 else row for row in np.moveaxis(rows, axis, 0)]


def _pad(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    table, fill = given
    for axis, (before, after, between) in enumerate(equation.params["padding_config"][: table.ndim]):
        if min(before, after) < 0 or between:
            raise NotImplementedError("a padding that is negative or between rows in a kernel")
        parts = [
            np.broadcast_to(fill, (*table.shape[:axis], size, *table.shape[axis + 1 :])) for size in (before, after)
        ]
        table = np.concatenate([parts[0], table, parts[1]], axis)
    return [table]


def _broadcast_in_dim(given: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    table, shape = given[0], rows_of(equation.outvars[0].aval.shape)
    dimensions = equation.params["broadcast_dimensions"]
    if has_lanes(equation.invars[0].aval.shape):
        dimensions = dimensions[:-1]
    elif dimensions and dimensions[-1] == len(shape):  # an axis of length 1 becomes lanes
        dimensions, table = dimensions[:-1], table.reshape(table.shape[:-1])
    aligned = [1] * len(shape)
    for axis, size in zip(dimensions, table.shape, strict=True):
        aligned[axis] = size
    return [np.broadcast_to(table.reshape(aligned), shape)]


def _iota(_: list[Values], equation: Any) -> list[Values]:  # noqa: ANN401
    shape, axis = rows_of(equation.outvars[0].aval.shape), equation.params["dimension"]
    numbers = np.arange(shape[axis], dtype=equation.params["dtype"])
    return [known_values(np.broadcast_to(np.expand_dims(numbers, [k for k in range(len(shape)) if k != axis]), shape))]


def _same(given: list[Values], _: Any) -> list[Values]:  # noqa: ANN401
    return given


# By the name of JAX's operation: takes arrays and the equation, and returns arrays. If lanes would move too, the
# results have other shapes than JAX's.
MOVES: Final[Mapping[str, Callable[[list[Values], Any], list[Values]]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "concatenate": _concatenate,
    "expand_dims": _reshape,
    "iota": _iota,
    "optimization_barrier": _same,
    "pad": _pad,
    "reshape": _reshape,
    "reshard": _same,  # in a program for a mesh
    "slice": _slice,
    "squeeze": _reshape,
    "stack": _stack,
    "unstack": _unstack,
}

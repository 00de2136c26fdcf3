"""Spaces of actions and observations: shape, dtype, bounds, samples and membership, without gymnasium."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import check_instance, check_option, check_real, check_whole, cut
from iphyre_jax.memory import check_memory

MAX_AXIS = 2**31 - 1


@dataclass(frozen=True)
class Box:
    """Arrays of one shape and dtype between two bounds.

    Attributes:
        low: lower bound of every entry; -inf for none.
        high: upper bound of every entry, included; inf for none.
        shape: of the arrays.
        dtype: "float32" or "uint8".

    Raises:
        ValueError: the bounds, the shape or the dtype are not such; one line.
    """

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: str = "float32"

    def __post_init__(self) -> None:
        """Check the attributes."""
        check_option("dtype", self.dtype, ("float32", "uint8"))
        for name in ("low", "high"):
            check_real(name, getattr(self, name))
        if not self.low <= self.high:
            raise ValueError(f"low: expected at most high, {self.high}, got {self.low}")
        for axis in check_instance("shape", self.shape, tuple, "a tuple of whole numbers"):
            check_whole("shape", axis, 0, MAX_AXIS)

    def sample(self, key: jax.Array) -> jax.Array:
        """Return a random member: uniform between the bounds, standard normal and cut where one is infinite.

        Raises:
            ValueError: it does not fit into memory; one line.
        """
        check_memory("shape", 8 * math.prod(self.shape), "sample a smaller space")
        if not np.isfinite([self.low, self.high]).all():
            return jax.random.normal(key, self.shape, jnp.float32).clip(self.low, self.high)
        if self.dtype == "uint8":
            return jax.random.randint(key, self.shape, int(self.low), int(self.high) + 1, np.int32).astype(self.dtype)
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def array(self, value: object, lanes: tuple[int, ...] = ()) -> jax.Array:
        """Return a value as an array of the space's shape, with lanes behind; it may lie outside the bounds.

        Integers and bfloat16 get the space's dtype, in which 15 x action cannot wrap round; float64 stays.

        Raises:
            ValueError: it has another shape or is not numeric; one line.
        """
        array = jnp.asarray(_checked(value, (*self.shape, *lanes), (np.floating, np.integer), "numbers"))
        return array if array.dtype.kind == "f" else array.astype(self.dtype)

    def contains(self, value: npt.ArrayLike) -> bool:
        """Return whether a value has the shape and dtype and lies between the bounds (host)."""
        array: np.ndarray[Any, Any] = np.asarray(value)
        inside = array.shape == self.shape and array.dtype == np.dtype(self.dtype)
        return inside and bool(((array >= self.low) & (array <= self.high)).all())


@dataclass(frozen=True)
class Discrete:
    """The whole numbers 0 .. n - 1.

    Attributes:
        n: how many.
        dtype: of a sample.

    Raises:
        ValueError: n is no whole number from 1 to 2**31 - 1; one line.
    """

    n: int
    dtype: str = "int32"

    def __post_init__(self) -> None:
        """Check the number."""
        check_whole("n", self.n, 1, MAX_AXIS)
        check_option("dtype", self.dtype, ("int32", "int64"))

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a member, which has no axes."""
        return ()

    def sample(self, key: jax.Array) -> jax.Array:
        """Return a random member, () int32."""
        return jax.random.randint(key, (), 0, self.n, self.dtype)

    def array(self, value: object, lanes: tuple[int, ...] = ()) -> jax.Array:
        """Return a value as an array whose only axes are lanes; it may lie outside the range.

        Raises:
            ValueError: it has another shape or is not of integers; one line.
        """
        array = _checked(value, lanes, (np.integer,), "whole numbers")
        if array.dtype.itemsize > np.dtype(np.int32).itemsize:  # narrowed, another number could become an action
            array = cut(array, -1, self.n)
        return jnp.asarray(array)

    def contains(self, value: npt.ArrayLike) -> bool:
        """Return whether a value is one whole number of the range (host)."""
        array = np.asarray(value)
        return array.shape == () and array.dtype.kind in "iu" and 0 <= int(array) < self.n


Space = Box | Discrete


def _checked(value: object, shape: tuple[int, ...], kinds: Sequence[type[np.generic]], wanted: str) -> Any:  # noqa: ANN401
    """Return an action as an array of NumPy or JAX; inside `jax.jit` only its shape and dtype are checked."""
    array: Any = value if isinstance(value, jax.Array) else _array(value)
    is_duration = array.dtype.kind == "m"  # which NumPy counts as an integer
    if is_duration or not any(jnp.issubdtype(array.dtype, kind) for kind in kinds):
        raise ValueError(f"action: expected {wanted}, got dtype {array.dtype}")
    if array.shape != shape:
        raise ValueError(f"action: expected shape {shape}, got {array.shape}")
    return array


def _array(value: Any) -> Any:  # noqa: ANN401 - of NumPy or JAX
    """Return an array; of traced numbers one of JAX."""
    try:
        return np.asarray(value)
    except ValueError:
        raise ValueError("action: expected an array, got rows of unequal length") from None
    except jax.errors.TracerArrayConversionError:
        pass
    try:
        return jnp.asarray(value)
    except TypeError:
        raise ValueError(f"action: expected an array, got a {type(value).__name__} of {len(value)}") from None

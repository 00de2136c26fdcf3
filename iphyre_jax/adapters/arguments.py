"""Checks of what adapters on the host are given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED, check_whole
from iphyre_jax.envs.spaces import Discrete, Space

SEEDS = 2**31  # seeds of keys, drawn from an environment's generator


def refuse_options(options: Mapping[str, object], names: tuple[str, ...], why: str) -> None:
    """Raise ValueError, one line, if options of `iphyre_jax.make` hold one that the adapter decides itself."""
    if taken := [name for name in names if name in options]:
        raise ValueError(f"{taken[0]}: expected none{why}")


def checked_seed(seed: object) -> int | None:
    """Return a seed as an int, or None; ValueError in one line unless it is one or the other."""
    return None if seed is None else check_whole("seed", seed, 0, MAX_SEED)


def as_array(name: str, value: Any) -> npt.NDArray[Any]:  # noqa: ANN401 - whatever the user takes for one
    """Return a value as an array; ValueError in one line for rows of unequal length."""
    try:
        return np.asarray(value)
    except ValueError:
        raise ValueError(f"{name}: expected an array, got rows of unequal length") from None


def checked_action(
    space: Space,
    action: Any,  # noqa: ANN401
    batch: tuple[int, ...],
    idle: npt.NDArray[np.bool_] | None = None,
) -> npt.NDArray[Any]:
    """Return an action, or a batch of actions, as an array of the space's dtype.

    Args:
        space: of one action.
        action: what the caller gave.
        batch: shape of the batch; () for one action.
        idle: of that shape, the worlds whose actions may be any; 0, which all spaces have, takes their place.

    Raises:
        ValueError: it has another shape or dtype, or lies outside the space; one line.
    """
    array = as_array("action", action)
    if array.shape != batch + space.shape:
        raise ValueError(f"action: expected shape {batch + space.shape}, got {array.shape}")
    if idle is not None and array.dtype.kind in "fiu":
        array = array.copy()
        array[idle] = 0
    if isinstance(space, Discrete):
        if array.dtype.kind not in "iu":
            raise ValueError(f"action: expected whole numbers, got dtype {array.dtype}")
        if array.size and not (array.min() >= 0 and array.max() < space.n):
            raise ValueError(f"action: expected numbers from 0 to {space.n - 1}, got {array.min()} to {array.max()}")
        return array.astype(np.int32)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"action: expected numbers, got dtype {array.dtype}")
    if not ((array >= space.low) & (array <= space.high)).all():
        raise ValueError(f"action: expected numbers from {space.low:g} to {space.high:g}, got one outside or NaN")
    return array.astype(space.dtype)

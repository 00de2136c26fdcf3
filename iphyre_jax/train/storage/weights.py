"""Arrays of trained networks in files: verified, and put back into the tree that they came from."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy.typing as npt

from iphyre_jax.files import file_sum
from iphyre_jax.train.storage.checkpoint import named_arrays


def verify_sum(file: Path, sha256: object) -> None:
    """Raise ValueError, one line, unless NAME.npz has the sum that NAME.json tells of."""
    if file_sum(file) != sha256:
        raise ValueError(f"{file}: damaged: it does not have the SHA-256 sum of {file.stem}.json")


def restored(arrays: Mapping[str, npt.NDArray[Any]], like: Any, file: Path) -> Any:  # noqa: ANN401 - any tree
    """Return a tree of arrays like another, with arrays by the names of `named_arrays`.

    Args:
        arrays: by name.
        like: a tree of arrays, or of their shapes and dtypes.
        file: where the arrays are from, for errors.

    Raises:
        ValueError: one line; an array is missing, unknown, or of another shape.
    """
    expected = named_arrays(like)
    for key in sorted({*expected, *arrays}):
        if key not in expected or key not in arrays:
            raise ValueError(f"{file}: {key}: {'not expected' if key in arrays else 'missing'}")
        if arrays[key].shape != expected[key].shape:
            raise ValueError(f"{file}: {key}: expected shape {expected[key].shape}, got {arrays[key].shape}")
    # `jnp.asarray` would compile a program for each shape.
    leaves = jax.device_put([arrays[key].astype(leaf.dtype) for key, leaf in expected.items()])
    return jax.tree.unflatten(jax.tree.structure(like), leaves)

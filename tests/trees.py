"""Trees of arrays, compared."""

from __future__ import annotations

import jax
import numpy as np


def assert_equal_trees(one: object, other: object) -> None:
    """Expect the same structure, dtypes and numbers; a zero may have another sign."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b)

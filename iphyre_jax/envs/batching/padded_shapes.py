"""Arrays of one shape for worlds of several topologies: zeros pad the smaller ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Tree = TypeVar("Tree")


@dataclass(frozen=True)
class PaddedShapes:
    """The shapes to which the arrays of a tree are padded; hashable."""

    structure: Any  # jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, tree: object) -> PaddedShapes:
        """Return the shapes of a tree of arrays."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(structure, tuple(tuple(leaf.shape) for leaf in leaves))

    @classmethod
    def largest(cls, many: Sequence[PaddedShapes]) -> PaddedShapes:
        """Return the least shapes that hold all of the given ones."""
        columns = zip(*(one.shapes for one in many), strict=True)
        return cls(many[0].structure, tuple(tuple(np.max(shapes, axis=0).tolist()) for shapes in columns))

    def unpad(self, tree: Tree) -> Tree:
        """Return the first rows of every array; lanes behind them stay."""
        leaves = self.structure.flatten_up_to(tree)
        cut = [leaf[tuple(slice(n) for n in shape)] for shape, leaf in zip(self.shapes, leaves, strict=True)]
        return self.structure.unflatten(cut)

    def pad(self, tree: Tree) -> Tree:
        """Return every array with zeros behind its rows; lanes behind them stay."""
        leaves = self.structure.flatten_up_to(tree)
        return self.structure.unflatten([_pad(leaf, shape) for shape, leaf in zip(self.shapes, leaves, strict=True)])


def _pad(leaf: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    missing = [(0, n - leaf.shape[axis]) for axis, n in enumerate(shape)]
    lanes = [(0, 0)] * (leaf.ndim - len(shape))
    return jnp.pad(leaf, missing + lanes) if any(n for _, n in missing) else leaf

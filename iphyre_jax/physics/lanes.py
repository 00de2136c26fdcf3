"""Small helpers for arrays whose trailing axes are lanes (many worlds side by side)."""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Tree = TypeVar("Tree")

WORD = 32  # candidate pairs a machine word of flags


def row(tree: Tree, index: jax.Array | int) -> Tree:
    """Return row `index` of every array of `tree`; the index is the same for all lanes."""
    if isinstance(index, int):
        return jax.tree.map(lambda leaf: leaf[index], tree)
    return jax.tree.map(lambda leaf: jax.lax.dynamic_index_in_dim(leaf, index, 0, keepdims=False), tree)


def set_row(tree: Tree, index: jax.Array, value: Tree) -> Tree:
    """Return `tree` with row `index` of every array replaced; the index is the same for all lanes."""
    return jax.tree.map(lambda leaf, new: jax.lax.dynamic_update_index_in_dim(leaf, new, index, 0), tree, value)


def pick(rows: list[jax.Array], index: jax.Array) -> jax.Array:
    """Return in each lane the row that `index` names there, 0 where it names none."""
    out = jnp.zeros_like(rows[0])
    for i, value in enumerate(rows):
        out = jnp.where(index == i, value, out)
    return out


def iota(n: int, like: jax.Array) -> jax.Array:
    """Return 0 .. n-1 as int32, shaped to broadcast over the lanes of `like`, an array without row axis."""
    return jnp.arange(n, dtype=jnp.int32).reshape(n, *(1,) * like.ndim)


def any_lane(flags: jax.Array) -> jax.Array:
    """Return for each row of (P, *lanes) flags whether any lane has it set, as words of 32 bits, (words,) uint32.

    One OR-reduction over integers is much faster on a CPU than P reductions over booleans.
    """
    words = []
    for start in range(0, flags.shape[0], WORD):
        part = flags[start : start + WORD]
        bits = np.left_shift(np.uint32(1), np.arange(part.shape[0], dtype=np.uint32)).reshape(
            -1, *(1,) * (part.ndim - 1)
        )
        packed = jnp.sum(jnp.where(part, bits, np.uint32(0)), axis=0, dtype=jnp.uint32)
        words.append(jax.lax.reduce(packed, np.uint32(0), jax.lax.bitwise_or, tuple(range(packed.ndim))))
    return jnp.stack(words)


def first_set(words: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the index of the lowest set bit of `words`, and the words without it. At least one bit must be set."""
    word, value = jnp.int32(0), words[0]
    for later in range(1, words.shape[0]):  # the first word that is not empty
        empty = value == 0
        word, value = jnp.where(empty, jnp.int32(later), word), jnp.where(empty, words[later], value)
    lowest = jax.lax.population_count((value & (~value + np.uint32(1))) - np.uint32(1))
    return word * WORD + lowest.astype(jnp.int32), words.at[word].set(value & (value - np.uint32(1)))

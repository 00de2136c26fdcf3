"""Small helpers for arrays whose trailing axes are lanes (many worlds side by side).

Loops work on tables: arrays with one row for each thing that the loop visits. Rows are read and stacked behind
optimization barriers. Without them the compiler fuses the read into the loop over lanes, loads the row's index again
for every lane (or chooses among the stacked parts there), and does not vectorise the loop.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata

Tree = TypeVar("Tree")
Carry = TypeVar("Carry")

WORD = 32  # flags a machine word
# XLA's option to compute several results in one loop. Our compiler processes have it (`execution/compilation/options`).
MULTI_OUTPUT_FUSION: Final = "xla_cpu_use_multi_output_fusion=true"
_results_share_loops = MULTI_OUTPUT_FUSION in os.environ.get("XLA_FLAGS", "")


def read(tables: Tree, row: jax.Array) -> Tree:
    """Return one row of every array of `tables`; the index is the same for all lanes."""
    rows = jax.tree.map(lambda table: jax.lax.dynamic_index_in_dim(table, row, 0, keepdims=False), tables)
    return jax.lax.optimization_barrier(rows)


def write(tables: Tree, row: jax.Array, values: Tree) -> Tree:
    """Return `tables` with one row of every array replaced; the index is the same for all lanes."""
    return jax.tree.map(lambda table, value: jax.lax.dynamic_update_index_in_dim(table, value, row, 0), tables, values)


def blank(like: jax.Array) -> jax.Array:
    """Return an array for `fill` with no place filled, of the shape and dtype of `like`: zeros, or negative zeros."""
    return jnp.full_like(like, -np.zeros((), like.dtype))


def fill(table: jax.Array, here: jax.Array, new: jax.Array) -> jax.Array:
    """Return `table` with `new` where `here` is set; what was there must be `blank`.

    A sum with a negative zero is exact, and keeps the sign of a zero. A choice between new and old would be stored in
    place through a mask, which takes some twenty cycles a vector on AMD processors without AVX-512.
    """
    return table + jnp.where(here, new, -np.zeros((), table.dtype))


def stack(rows: Sequence[jax.Array], axis: int = 0) -> jax.Array:
    """Stack arrays of one shape."""
    return jax.lax.optimization_barrier(jnp.stack(rows, axis))


def materialize(work: Callable[[], Tree]) -> Tree:
    """Return work(), all of its results in memory before anything reads one of them; traced.

    On a CPU XLA makes a loop for each result. What results share, it computes in each of the loops, and again where a
    result is read. A call that XLA must not inline ends that. In our compiler processes XLA has a loop for several
    results, and calls would cost up to a third.

    Args:
        work: returns a tree of arrays. Outside of a traced function it is compiled at each call.
    """
    if _results_share_loops or jax.default_backend() != "cpu":
        return work()
    result: Tree = set_xla_metadata(jax.jit(work)(), inlineable="false")  # the mark of a result is that of the call
    return result


def visit(tables: Tree, count: jax.Array, body: Callable[[jax.Array, Tree, Carry], Carry], carry: Carry) -> Carry:
    """Return `carry` after body(k, row k of the tables, carry) for k = 0 .. count - 1; count may be traced."""
    return jax.lax.fori_loop(0, count, lambda k, carry: body(k, read(tables, k), carry), carry)


def pick(rows: Sequence[jax.Array], index: jax.Array) -> jax.Array:
    """Return in each lane the row that `index` names there, 0 where it names none."""
    out = jnp.zeros_like(rows[0])
    for i, value in enumerate(rows):
        out = jnp.where(index == i, value, out)
    return out


def iota(n: int, like: jax.Array) -> jax.Array:
    """Return 0 .. n-1 as int32, shaped to broadcast over the lanes of `like`, an array without row axis."""
    return jnp.arange(n, dtype=jnp.int32).reshape(n, *(1,) * like.ndim)


def any_lane(flags: jax.Array) -> tuple[jax.Array, ...]:
    """Return for each row of (P, *lanes) flags whether any lane has it set, as words of 32 bits, () uint32 each.

    One OR-reduction over integers is much faster on a CPU than P reductions over booleans. A GPU's kernels keep rows
    apart, and reduce each of them (`execution/gpu/row_by_row`).
    """
    words = []
    if jax.default_backend() != "cpu":
        flags = jnp.any(flags, axis=tuple(range(1, flags.ndim)))
    for start in range(0, flags.shape[0], WORD):
        part = flags[start : start + WORD]
        bits = np.left_shift(np.uint32(1), np.arange(part.shape[0], dtype=np.uint32))
        bits = bits.reshape(-1, *(1,) * (part.ndim - 1))
        packed = jnp.sum(jnp.where(part, bits, np.uint32(0)), axis=0, dtype=jnp.uint32)
        words.append(jax.lax.reduce(packed, np.uint32(0), jax.lax.bitwise_or, tuple(range(packed.ndim))))
    return tuple(words)


def any_set(words: tuple[jax.Array, ...]) -> jax.Array:
    """Return whether any flag is set."""
    out = words[0] != 0
    for word in words[1:]:
        out = out | (word != 0)
    return out


def take_first(words: tuple[jax.Array, ...]) -> tuple[jax.Array, tuple[jax.Array, ...]]:
    """Return the index of the first set flag, and the words without it; beyond the last one if none is set."""
    index, open_, left = jnp.int32(WORD * len(words)), words[0] == words[0], []
    for k, word in enumerate(words):
        here = open_ & (word != 0)
        lowest = jax.lax.population_count((word & (~word + np.uint32(1))) - np.uint32(1)).astype(jnp.int32)
        index = jnp.where(here, WORD * k + lowest, index)
        left.append(jnp.where(here, word & (word - np.uint32(1)), word))
        open_ = open_ & (word == 0)
    return index, tuple(left)


def visit_any(flags: jax.Array, body: Callable[[jax.Array, Carry], Carry], carry: Carry) -> Carry:
    """Return `carry` after body(k, carry) for each row k of (P, *lanes) flags that any lane has set, in their order.

    A row is found one turn ahead: in the turn that works it out, what depends on it would be scalar code.
    """

    def turn(loop: tuple[jax.Array, tuple[jax.Array, ...], Carry]) -> tuple[jax.Array, tuple[jax.Array, ...], Carry]:
        row, words, carry = loop
        return *take_first(words), body(row, carry)

    start = *take_first(any_lane(flags)), carry
    return jax.lax.while_loop(lambda loop: loop[0] < flags.shape[0], turn, start)[2]


def if_any(flags: jax.Array, body: Callable[[Carry], Carry], carry: Carry) -> Carry:
    """Return body(carry) if any lane has a flag set, (*lanes,), else `carry`, which changes in place."""
    return jax.lax.fori_loop(0, jnp.any(flags).astype(jnp.int32), lambda _, carry: body(carry), carry)

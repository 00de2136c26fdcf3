"""Trees of arrays as one flat table of words.

Each argument of a compiled program costs the host some microseconds a call, so a program takes few arrays. A world, or
the state of an episode, is packed into one table, (rows, lanes), of 32-bit words (float32) or 64-bit words (float64):
whole numbers and flags first, then the bits of floating-point numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, reduce
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

Number = TypeVar("Number", bound=np.generic)
Words = npt.NDArray[np.signedinteger[Any]]

BLOCK = 48  # rows transposed at a time: as many lines as the first cache holds of rows 512 bytes apart
FLAGS = 32  # of a word
BIT = np.left_shift(np.int32(1), np.arange(FLAGS, dtype=np.int32))
WORD: dict[str, np.dtype[np.signedinteger[Any]]] = {"float32": np.dtype("int32"), "float64": np.dtype("int64")}


def flag_words(count: int) -> int:
    """Return how many words hold so many flags."""
    return -(-count // FLAGS)


def pack_flags(flags: Sequence[jax.Array] | jax.Array) -> list[jax.Array]:
    """Return flags, each () bool, as bits of words, each () int32; lanes stay behind."""
    words = []
    for start in range(0, len(flags), FLAGS):
        bits = [jnp.where(flag, BIT[k], 0) for k, flag in enumerate(flags[start : start + FLAGS])]
        words.append(reduce(jnp.bitwise_or, bits))
    return words


def pack_numbers(numbers: jax.Array, flags: jax.Array, count: int) -> list[jax.Array]:
    """Return the set of the numbers that have a flag, as bits of words, each () int32; lanes stay behind.

    Args:
        numbers: (n,) int32; those that are not in 0 .. count - 1 are left out.
        flags: (n,) bool.
        count: of the set's possible members.
    """
    words = []
    for first in range(0, count, FLAGS):
        place = numbers - first
        bits = jnp.left_shift(jnp.int32(1), place.clip(0, FLAGS - 1))
        words.append(reduce(jnp.bitwise_or, jnp.where(flags & (place >= 0) & (place < FLAGS), bits, 0)))
    return words


def unpack_flags(words: Sequence[jax.Array] | jax.Array, count: int) -> jax.Array:
    """Return the first flags, (count,) bool, of words, (words,) integers; lanes stay behind."""
    flags = [(words[k // FLAGS].astype(jnp.int32) & BIT[k % FLAGS]) != 0 for k in range(count)]
    return jnp.stack(flags)


class Parts(NamedTuple):
    """A table in two parts, for programs that need derivatives: bits have none."""

    whole: jax.Array  # (rows, lanes), words: whole numbers and flags
    numbers: jax.Array  # (rows, lanes), floating-point numbers

    def padded(self, rows: tuple[int, int]) -> Parts:
        """Return the parts with zeros behind, so that they have so many rows."""
        parts = zip(self, rows, strict=True)
        return Parts(*(jnp.pad(part, [(0, most - len(part)), *[(0, 0)] * (part.ndim - 1)]) for part, most in parts))


@dataclass(frozen=True)
class Layout:
    """The rows of a table that hold each array of a tree. Hashable.

    Attributes:
        structure: of the tree.
        shapes: of its arrays, without lanes.
        dtypes: of the arrays: "bool", "int32", or `dtype`.
        dtype: of the floating-point numbers, "float32" or "float64".
    """

    structure: Any  # jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[str, ...]
    dtype: str

    @classmethod
    def of(cls, tree: object, dtype: str) -> Layout:
        """Return the layout of a tree of arrays or shapes, without lanes; dtype: of its floating-point numbers."""
        leaves, structure = jax.tree.flatten(tree)
        shapes = tuple(tuple(leaf.shape) for leaf in leaves)
        return cls(structure, shapes, tuple(np.dtype(leaf.dtype).name for leaf in leaves), dtype)

    @property
    def word(self) -> str:
        """The dtype of the table."""
        return WORD[self.dtype].name

    @property
    def word_size(self) -> int:
        """The bytes of a word."""
        return WORD[self.dtype].itemsize

    @cached_property
    def rows(self) -> int:
        """The number of rows of the table."""
        return sum(map(math.prod, self.shapes))

    @cached_property
    def whole_rows(self) -> int:
        """The number of rows with whole numbers and flags, which come first."""
        return sum(
            math.prod(shape) for shape, dtype in zip(self.shapes, self.dtypes, strict=True) if dtype != self.dtype
        )

    @property
    def part_rows(self) -> tuple[int, int]:
        """The number of rows of each of the two `Parts`."""
        return self.whole_rows, self.rows - self.whole_rows

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """The first row of each array."""
        starts, whole, number = [], 0, self.whole_rows
        for shape, dtype in zip(self.shapes, self.dtypes, strict=True):
            is_number = dtype == self.dtype
            starts.append(number if is_number else whole)
            whole, number = whole + (not is_number) * math.prod(shape), number + is_number * math.prod(shape)
        return tuple(starts)

    def pack(self, tree: object) -> jax.Array:
        """Return the table of a tree, (rows, lanes); its arrays have lanes behind their own axes; traced."""
        whole, numbers = self.parts(tree)
        return jnp.concatenate([whole, jax.lax.bitcast_convert_type(numbers, self.word)])

    def parts(self, tree: object) -> Parts:
        """Return the two parts of the table of a tree, which has lanes behind; traced."""
        leaves = self.structure.flatten_up_to(tree)
        lanes = jnp.shape(leaves[0])[-1]
        whole = [jnp.zeros((0, lanes), self.word)]
        numbers = [jnp.zeros((0, lanes), self.dtype)]
        for leaf, shape, dtype in zip(leaves, self.shapes, self.dtypes, strict=True):
            flat = jnp.broadcast_to(leaf, (*shape, lanes)).reshape(math.prod(shape), lanes)
            (numbers if dtype == self.dtype else whole).append(flat)
        return Parts(jnp.concatenate([part.astype(self.word) for part in whole]), jnp.concatenate(numbers))

    def unpack(self, table: jax.Array) -> Any:  # noqa: ANN401 - a tree of the layout's structure
        """Return the tree of a table (rows, lanes), lanes behind each array's own axes; traced."""
        numbers = jax.lax.bitcast_convert_type(table[self.whole_rows : self.rows], self.dtype)
        return self.join(Parts(table[: self.whole_rows], numbers))

    def join(self, parts: Parts) -> Any:  # noqa: ANN401 - a tree of the layout's structure
        """Return the tree of two parts, lanes behind each array's own axes; further rows do not matter; traced."""
        leaves = []
        for start, shape, dtype in zip(self.starts, self.shapes, self.dtypes, strict=True):
            if dtype == self.dtype:
                table, first = parts.numbers, start - self.whole_rows
            else:
                table, first = parts.whole, start
            part = table[first : first + math.prod(shape)].reshape(*shape, table.shape[-1])
            leaves.append(part != 0 if dtype == "bool" else part.astype(dtype))
        return self.structure.unflatten(leaves)

    def pack_many(self, trees: Sequence[object]) -> Words:
        """Return the table of several trees without lanes, one a column, (rows, trees); NumPy."""
        table = np.zeros((self.rows, len(trees)), self.word)
        columns = zip(*map(self.structure.flatten_up_to, trees), strict=True)
        for leaves, start, shape, dtype in zip(columns, self.starts, self.shapes, self.dtypes, strict=bool(trees)):
            flat = np.array(leaves).reshape(len(trees), math.prod(shape))
            table[start : start + flat.shape[1]] = (flat.view(self.word) if dtype == self.dtype else flat).T
        return table

    def unpack_numpy(self, table: Words) -> Any:  # noqa: ANN401 - a tree of the layout's structure
        """Do what `unpack` does, in NumPy."""
        leaves = []
        for start, shape, dtype in zip(self.starts, self.shapes, self.dtypes, strict=True):
            part = np.ascontiguousarray(table[start : start + math.prod(shape)]).reshape(*shape, table.shape[-1])
            leaves.append(part.view(dtype) if dtype == self.dtype else part.astype(dtype))
        return self.structure.unflatten(leaves)

    def first_rows(self) -> Any:  # noqa: ANN401 - a tree of the layout's structure
        """Return the first row of each array, as a tree."""
        return self.structure.unflatten(self.starts)


def write_transposed(table: jax.Array, out: jax.Array, first: jax.Array, column: int = 0) -> jax.Array:
    """Return `out`, one world a row, with a table (rows, lanes) written into it; traced.

    Args:
        table: its rows go into columns.
        out: (worlds, columns). Into words go the bits of floating-point numbers.
        first: () int32, first row to write.
        column: first column to write.
    """
    for start in range(0, table.shape[0], BLOCK):
        part = table[start : start + BLOCK].T
        if jnp.issubdtype(part.dtype, jnp.floating) and not jnp.issubdtype(out.dtype, jnp.floating):
            part = jax.lax.bitcast_convert_type(part, WORD[part.dtype.name])
        out = jax.lax.dynamic_update_slice(out, part.astype(out.dtype), (first, np.int32(column + start)))
    return out


def read_columns(source: jax.Array, rows: jax.Array, width: int, column: int = 0) -> jax.Array:
    """Return rows of a table as columns, (width, lanes), without what is in front and behind; traced, for a CPU.

    A gather and a transposition take three times as long.

    Args:
        source: (B, columns).
        rows: (lanes,) int32.
        width: columns to read.
        column: first column to read.
    """
    out = jnp.zeros((width, rows.shape[0]), source.dtype)
    for start in range(0, width, BLOCK):
        size = min(BLOCK, width - start)

        def read(k: jax.Array, out: jax.Array, start: int = start, size: int = size) -> jax.Array:
            row = jax.lax.dynamic_slice(source, (rows[k], np.int32(column + start)), (1, size))
            return jax.lax.dynamic_update_slice(out, row.T, (np.int32(start), jnp.int32(k)))

        out = jax.lax.fori_loop(0, rows.shape[0], read, out)
    return out


def write_columns(table: jax.Array, out: jax.Array, rows: jax.Array, count: jax.Array, column: int = 0) -> jax.Array:
    """Return `out`, one world a row, with columns of a table written into it; traced, for a CPU.

    Args:
        table: (words, lanes).
        out: (B, columns).
        rows: (lanes,) int32, where each column goes.
        count: () int32, columns of the table to write, the first ones.
        column: first column of `out` to write.
    """
    for start in range(0, table.shape[0], BLOCK):
        block = table[start : start + BLOCK]

        def row(k: jax.Array, out: jax.Array, start: int = start, block: jax.Array = block) -> jax.Array:
            own = jax.lax.dynamic_slice(block, (np.int32(0), jnp.int32(k)), (block.shape[0], 1))
            return jax.lax.dynamic_update_slice(out, own.T, (rows[k], np.int32(column + start)))

        out = jax.lax.fori_loop(0, count, row, out)
    return out


def fill_lanes(numbers: npt.NDArray[Number], lanes: int) -> npt.NDArray[Number]:
    """Return one number for each lane, (lanes,); spare lanes repeat the last one."""
    return numbers[np.minimum(np.arange(lanes), len(numbers) - 1)]


def pieces(table: npt.NDArray[Any], first: int, width: int) -> npt.NDArray[np.void]:
    """Return some columns of a table with contiguous rows, each row as a single value, which is copied as one."""
    size = table.itemsize
    return np.ndarray((len(table),), void(width * size), table, first * size, (table.strides[0],))


@cache
def void(size: int) -> np.dtype[np.void]:
    """Return the type of a value of so many bytes."""
    return np.dtype((np.void, size))

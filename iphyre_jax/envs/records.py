"""What a loop writes down at each turn, in one table a type.

A scan that stacks several results updates several arrays by one row a turn. With `configure`'s multi-output fusion the
compiler makes one loop of those updates, which then runs over all rows of all arrays: each turn costs as much as the
whole record. One array is updated in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp

Carry = TypeVar("Carry")
Record = TypeVar("Record")

_WORD = jnp.dtype("int32")


def scan(turn: Callable[[Carry, jax.Array], tuple[Carry, Record]], start: Carry, turns: int) -> tuple[Carry, Record]:
    """Do what `jax.lax.scan` over 0 .. turns - 1 does, for records whose arrays all end in the same lanes.

    Args:
        turn: a function of the carry and the number of the turn, () int32.
        start: the carry before the first.
        turns: how many.
    """
    _, form = jax.eval_shape(turn, start, jax.ShapeDtypeStruct((), jnp.int32))

    def written(carry: Carry, count: jax.Array) -> tuple[Carry, dict[str, jax.Array]]:
        carry, record = turn(carry, count)
        return carry, _written(record)

    end, tables = jax.lax.scan(written, start, jnp.arange(turns, dtype=jnp.int32))
    return end, _read(tables, form)


def _table_of(dtype: Any) -> str:  # noqa: ANN401  # whatever has a dtype's name
    """Return the type of the table for values of a type: words hold everything up to 32 bits."""
    dtype = jnp.dtype(dtype)
    return str(_WORD if dtype.itemsize == _WORD.itemsize or dtype.kind == "b" else dtype)


def _written(record: Record) -> dict[str, jax.Array]:
    """Return the tables (rows, lanes) of one turn."""
    rows: dict[str, list[jax.Array]] = {}
    for leaf in jax.tree.leaves(record):
        table = _table_of(leaf.dtype)
        word = leaf.astype(table) if leaf.dtype == bool else jax.lax.bitcast_convert_type(leaf, table)
        rows.setdefault(table, []).append(word.reshape(-1, leaf.shape[-1]))
    # Joined and computed in one loop, every number would be chosen among the parts by a branch.
    return {table: jnp.concatenate(jax.lax.optimization_barrier(parts)) for table, parts in rows.items()}


def _read(tables: dict[str, jax.Array], form: Record) -> Record:
    """Return the records of all turns, turns in front, from their tables (turns, rows, lanes)."""
    leaves, structure = jax.tree.flatten(form)
    begin = dict.fromkeys(tables, 0)
    read = []
    for leaf in leaves:
        table = _table_of(leaf.dtype)
        count = math.prod(leaf.shape[:-1])
        part = tables[table][:, begin[table] : begin[table] + count]
        begin[table] += count
        part = part != 0 if leaf.dtype == bool else jax.lax.bitcast_convert_type(part, leaf.dtype)
        read.append(part.reshape(part.shape[0], *leaf.shape))
    return jax.tree.unflatten(structure, read)

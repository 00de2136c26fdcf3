"""What a loop writes down at each turn.

A scan that stacks several results updates several arrays by one row a turn. With `configure`'s multi-output fusion the
compiler makes one loop of those updates, which then runs over all rows of all arrays: each turn costs as much as the
whole record. So small arrays share one table a type, and each table is updated behind a barrier of its own, in place.
An array of many rows, such as an observation, is a table by itself, with lanes in front: turned over while it is in the
cache, not when a whole record is.
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
_MANY = 16  # rows


def scan(turn: Callable[[Carry, jax.Array], tuple[Carry, Record]], start: Carry, turns: int) -> tuple[Carry, Record]:
    """Do what `jax.lax.scan` over 0 .. turns - 1 does, for records whose arrays all end in the same lanes.

    Args:
        turn: a function of the carry and the number of the turn, () int32.
        start: the carry before the first.
        turns: how many.

    Returns:
        The carry after the last, and the records, (turns, lanes, ...).
    """
    _, form = jax.eval_shape(turn, start, jax.ShapeDtypeStruct((), jnp.int32))
    tables = jax.eval_shape(_written, form)

    def once(count: jax.Array, now: tuple[Carry, dict[str, jax.Array]]) -> tuple[Carry, dict[str, jax.Array]]:
        carry, record = turn(now[0], count)
        tables, rows = dict(now[1]), _written(record)
        for name in tables:
            tables[name] = jax.lax.dynamic_update_index_in_dim(tables[name], rows[name], count, 0)
            tables, rows = jax.lax.optimization_barrier((tables, rows))  # or the next update becomes part of this one
        return carry, tables

    empty = {name: jnp.zeros((turns, *table.shape), table.dtype) for name, table in tables.items()}
    end, written = jax.lax.fori_loop(0, turns, once, (start, empty))
    return end, _read(written, form)


def _table_of(place: int, leaf: Any) -> str:  # noqa: ANN401  # an array or its shape
    """Return the name of the table for an array: words hold everything up to 32 bits."""
    if math.prod(leaf.shape[:-1]) >= _MANY:
        return f"array {place}"
    dtype = jnp.dtype(leaf.dtype)
    return str(_WORD if dtype.itemsize == _WORD.itemsize or dtype.kind == "b" else dtype)


def _written(record: Record) -> dict[str, jax.Array]:
    """Return the tables of one turn: (lanes, ...) of many rows, (rows, lanes) of words."""
    tables: dict[str, jax.Array] = {}
    parts: dict[str, list[jax.Array]] = {}
    for place, leaf in enumerate(jax.tree.leaves(record)):
        table = _table_of(place, leaf)
        if table.startswith("array"):
            tables[table] = jnp.moveaxis(leaf, -1, 0)
            continue
        word = leaf.astype(table) if leaf.dtype == bool else jax.lax.bitcast_convert_type(leaf, table)
        parts.setdefault(table, []).append(word.reshape(-1, leaf.shape[-1]))
    # Joined and computed in one loop, every number would be chosen among the parts by a branch.
    joined = {table: jnp.concatenate(jax.lax.optimization_barrier(words)) for table, words in parts.items()}
    return tables | joined


def _read(tables: dict[str, jax.Array], form: Record) -> Record:
    """Return the records of all turns, (turns, lanes, ...), from their tables, turns in front."""
    leaves, structure = jax.tree.flatten(form)
    begin = dict.fromkeys(tables, 0)
    read = []
    for place, leaf in enumerate(leaves):
        table = _table_of(place, leaf)
        if table.startswith("array"):
            read.append(tables[table])
            continue
        count = math.prod(leaf.shape[:-1])
        part = tables[table][:, begin[table] : begin[table] + count]
        begin[table] += count
        part = part != 0 if leaf.dtype == bool else jax.lax.bitcast_convert_type(part, leaf.dtype)
        read.append(jnp.moveaxis(part.reshape(part.shape[0], *leaf.shape), -1, 1))
    return jax.tree.unflatten(structure, read)

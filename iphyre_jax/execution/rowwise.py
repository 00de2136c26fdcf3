"""Functions whose rows are independent, in programs that run on several devices."""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import Any, TypeVar

import jax
from jax.experimental.custom_partitioning import custom_partitioning
from jax.sharding import Mesh, NamedSharding, PartitionSpec

Shared = TypeVar("Shared")
Rows = TypeVar("Rows")
Results = TypeVar("Results")


def rowwise(work: Callable[[Shared, Rows], Results], shared: Shared, rows: Rows) -> Results:
    """Return work(shared, rows); if the rows are spread over devices, each device does its own, without any exchange.

    The compiler alone would gather all rows on all devices, because the work takes them in slices.

    Args:
        work: traced; row k of its results depends on `shared` and on row k of `rows` alone.
        shared: a tree of arrays.
        rows: a tree of arrays with one axis of rows in front, as its results have.
    """
    # Without jit, `custom_partitioning` refuses functions that close over arrays. JAX's types do not know the flag.
    if jax.config.jax_disable_jit:  # type: ignore[attr-defined]
        return work(shared, rows)
    work = jax.jit(work)  # traced once, not for its shapes too
    spread = custom_partitioning(work)

    def placed(tree: Any, sharding: NamedSharding) -> Any:  # noqa: ANN401 - any tree
        return jax.tree.map(lambda _: sharding, tree)

    def partition(mesh: Mesh, given: tuple[Any, Any], results: Any) -> tuple[Any, ...]:  # noqa: ANN401
        sharding = jax.tree.leaves(given[1])[0].sharding
        # Without a spec, as under a partly manual `shard_map`, every device does all rows.
        over = sharding.spec[:1] if isinstance(sharding, NamedSharding) else ()
        whole, own = NamedSharding(mesh, PartitionSpec()), NamedSharding(mesh, PartitionSpec(*over))
        return mesh, work, placed(results, own), (placed(given[0], whole), placed(given[1], own))

    names = map("axis{}".format, count())

    def axes_of(tree: Any, rows: bool) -> list[list[str]]:  # noqa: ANN401
        ranks = [len(leaf.shape) for leaf in jax.tree.leaves(tree)]
        return [["rows"] * rows + [next(names) for _ in range(rank - rows)] for rank in ranks]

    given = axes_of(shared, rows=False) + axes_of(rows, rows=True)
    results = axes_of(jax.eval_shape(work, shared, rows), rows=True)
    rule = " -> ".join(", ".join(map(" ".join, side)) for side in (given, results))
    unspread = tuple(axis for axes in given + results for axis in axes if axis != "rows")
    spread.def_partition(partition, sharding_rule=rule, need_replication_factors=unspread)
    result: Results = spread(shared, rows)
    return result

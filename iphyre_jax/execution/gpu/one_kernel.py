"""Parts of a program that an NVIDIA GPU runs as one kernel.

XLA makes a kernel of each fused operation, and a physics step has some hundred of them, with loops whose every turn the
host has to start. A thread that keeps its world in registers through all steps is many times as fast (see "On an NVIDIA
GPU" in docs/decisions/engine.md).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, partial
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.execution.gpu.row_by_row import evaluate
from iphyre_jax.execution.gpu.rows import LANES, has_lanes, rows_of, spread, values

Tree = TypeVar("Tree")

OLDEST: Final = "8.0"  # compute capability for which XLA has Triton
BLOCK: Final = 32  # lanes of a block, the threads of one warp: "any lane" means one of these


def in_one_kernel(work: Callable[..., Tree], shared: Any, tables: Any) -> Tree:  # noqa: ANN401 - trees of arrays
    """Return work(shared, tables); on an NVIDIA GPU as one kernel; traced.

    Args:
        work: returns a tree of arrays with lanes. Lane k of them depends on `shared` and on lane k of `tables` alone.
            It takes nothing traced from around it. Its derivatives are those of the plain form.
        shared: a tree of arrays without lanes.
        tables: a tree of arrays, (..., lanes).
    """
    if not _kernels_run():
        return work(shared, tables)
    try:
        return _with_derivatives(work)(shared, tables)
    except (AttributeError, ImportError, KeyError, NotImplementedError, TypeError, ValueError) as error:
        plain = work(shared, tables)  # if the work itself is wrong, it says so
        _warn(f"{type(error).__name__}: {error}")
        return plain


def _kernels_run() -> bool:
    """Return whether JAX's default device is a GPU for which XLA has Triton."""
    if jax.default_backend() != "gpu":
        return False
    device = jax.devices()[0]
    generation = int(getattr(device, "compute_capability", OLDEST).partition(".")[0])
    return device.device_kind.startswith("NVIDIA") and generation >= int(OLDEST.partition(".")[0])


def _with_derivatives(work: Callable[..., Tree]) -> Callable[..., Tree]:
    """Return a kernel whose derivatives are those of its work, and which is plain in a program for a CPU."""
    run: Callable[..., Tree] = jax.custom_jvp(
        lambda *given: jax.lax.platform_dependent(*given, cuda=partial(kernel, work), default=work)
    )

    def derivative(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Tree, Tree]:
        both: tuple[Tree, Tree] = jax.jvp(work, primals, tangents)
        return both

    run.defjvp(derivative)  # type: ignore[attr-defined]
    return run


@lru_cache(16)  # once for each reason
def _warn(reason: str) -> None:
    text = f"this version of JAX makes no kernel of the physics ({reason}); steps take many times as long"
    warnings.warn(text, RuntimeWarning, stacklevel=2)


def kernel(work: Callable[..., Tree], shared: Any, tables: Any, *, interpret: bool = False) -> Tree:  # noqa: ANN401
    """Do what `in_one_kernel` does; interpret: without a GPU, for tests.

    Raises:
        NotImplementedError: the work has an operation that `row_by_row` does not know.
    """
    from jax.experimental import pallas as pl  # takes a second to import
    from jax.experimental.pallas import triton

    shared, tables = jax.tree.map(jnp.asarray, (shared, tables))
    of_shared, of_tables = jax.tree.leaves(shared), jax.tree.leaves(tables)
    lanes = of_tables[0].shape[-1]
    jaxpr, structure = jax.make_jaxpr(work, return_shape=True)(
        jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), shared),
        jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-1], LANES), leaf.dtype), tables),
    )
    outs = jaxpr.out_avals
    if not all(has_lanes(out.shape) for out in outs):
        raise NotImplementedError("a result without lanes in a kernel")

    packed, counts = _pack(of_tables, lanes)
    scalars = [jnp.ravel(leaf) for leaf in of_shared]
    out_rows = _rows_of_words(outs)

    def body(*refs: Any) -> None:  # noqa: ANN401 - references of Pallas
        words, numbers, results = refs[: len(packed)], refs[len(packed) : -len(out_rows)], refs[-len(out_rows) :]
        read = {word: _read_rows(ref, counts[word]) for word, ref in zip(packed, words, strict=True)}
        given = [
            values(leaf.shape, [ref[k] for k in range(leaf.size)]) for leaf, ref in zip(of_shared, numbers, strict=True)
        ]
        given += [
            values(leaf.shape[:-1], [_from_word(next(read[_word(leaf.dtype)]), leaf.dtype) for _ in range(_rows(leaf))])
            for leaf in of_tables
        ]
        done = evaluate(jaxpr, given, BLOCK, pl.program_id(0) >> 30)
        left: dict[str, list[jax.Array]] = {word: [] for word in out_rows}
        for out, table in zip(outs, done, strict=True):
            if table.size:
                left[_word(out.dtype)] += [_to_word(spread(number, out.dtype, BLOCK)) for number in np.ravel(table)]
        for ref, rows in zip(results, left.values(), strict=True):
            _write_rows(ref, rows)

    blocks = -(-lanes // BLOCK)
    call = pl.pallas_call(
        body,
        grid=(blocks,),
        in_specs=[
            *(pl.BlockSpec((table.shape[0], BLOCK), lambda k: (0, k)) for table in packed.values()),
            *(pl.BlockSpec(numbers.shape, lambda _: (0,)) for numbers in scalars),
        ],
        out_specs=[pl.BlockSpec((rows, BLOCK), lambda k: (0, k)) for rows in out_rows.values()],
        out_shape=[jax.ShapeDtypeStruct((rows, blocks * BLOCK), word) for word, rows in out_rows.items()],
        compiler_params=None if interpret else triton.CompilerParams(num_warps=1, num_stages=1),
        interpret=interpret,
        name="physics",
    )
    written = dict(zip(out_rows, call(*packed.values(), *scalars), strict=True))
    return jax.tree.unflatten(jax.tree.structure(structure), _unpack(written, outs, lanes))


def _word(dtype: Any) -> str:  # noqa: ANN401
    """Return the words that carry numbers of a type: the widths of a GPU's registers."""
    return "int64" if np.dtype(dtype).itemsize == 8 else "int32"


def _to_word(numbers: jax.Array) -> jax.Array:
    if jnp.issubdtype(numbers.dtype, jnp.floating):
        return jax.lax.bitcast_convert_type(numbers, _word(numbers.dtype))
    return numbers.astype(_word(numbers.dtype))


def _from_word(words: jax.Array, dtype: Any) -> jax.Array:  # noqa: ANN401
    if jnp.issubdtype(dtype, jnp.floating):
        return jax.lax.bitcast_convert_type(words, dtype)
    return words != 0 if dtype == jnp.bool_ else words.astype(dtype)


def _rows(leaf: Any) -> int:  # noqa: ANN401
    return math.prod(leaf.shape[:-1])


def _room(rows: int) -> int:
    """Return the rows of a table with room for so many: a power of two, as Triton's arrays have."""
    return 1 << (rows - 1).bit_length()


def _rows_of_words(outs: Sequence[Any]) -> dict[str, int]:
    """Return how many rows of each width the table of some traced arrays has."""
    counts: dict[str, int] = {}
    for out in outs:
        counts[_word(out.dtype)] = counts.get(_word(out.dtype), 0) + math.prod(rows_of(out.shape))
    return {word: _room(rows) for word, rows in counts.items() if rows}


def _pack(leaves: Sequence[jax.Array], lanes: int) -> tuple[dict[str, jax.Array], dict[str, int]]:
    """Return arrays as one table for each width of words, (rows, whole blocks), and its rows; spare lanes repeat."""
    parts: dict[str, list[jax.Array]] = {}
    for leaf in leaves:
        if leaf.size:
            parts.setdefault(_word(leaf.dtype), []).append(_to_word(jnp.asarray(leaf)).reshape(-1, lanes))
    tables = {word: jnp.concatenate(rows) for word, rows in parts.items()}
    counts = {word: table.shape[0] for word, table in tables.items()}
    spare = ((0, 0), (0, -lanes % BLOCK))
    room = {word: ((0, _room(rows) - rows), (0, 0)) for word, rows in counts.items()}
    return {word: jnp.pad(jnp.pad(tables[word], spare, mode="edge"), room[word]) for word in tables}, counts


def _unpack(written: dict[str, jax.Array], outs: Sequence[Any], lanes: int) -> list[jax.Array]:
    """Return the arrays whose rows a kernel wrote."""
    first, leaves = dict.fromkeys(written, 0), []
    for out in outs:
        word, rows = _word(out.dtype), math.prod(rows_of(out.shape))
        if not rows:
            leaves.append(jnp.zeros((*rows_of(out.shape), lanes), out.dtype))
            continue
        part = written[word][first[word] : first[word] + rows, :lanes]
        first[word] += rows
        leaves.append(_from_word(part, out.dtype).reshape(*rows_of(out.shape), lanes))
    return leaves


def _read_rows(ref: Any, rows: int) -> Iterator[jax.Array]:  # noqa: ANN401
    """Return the rows of a table, (BLOCK,) each.

    They are read at once and then taken apart: the time to compile grows with reads times operations.
    """
    pieces = jax.lax.split(ref[...], (1,) * ref.shape[0], 0)
    return (row.reshape(BLOCK) for row in pieces[:rows])


def _write_rows(ref: Any, rows: Sequence[jax.Array]) -> None:  # noqa: ANN401
    """Write rows of (BLOCK,) into a table, at once."""
    blank = jnp.zeros((BLOCK,), rows[0].dtype)
    ref[...] = _joined([*rows, *[blank] * (ref.shape[0] - len(rows))]).reshape(BLOCK, ref.shape[0]).T


def _joined(rows: Sequence[jax.Array]) -> jax.Array:
    """Stack rows, a power of two of them, behind; the last of the axes tells even rows from odd ones."""
    return rows[0] if len(rows) == 1 else jnp.stack([_joined(rows[::2]), _joined(rows[1::2])], -1)

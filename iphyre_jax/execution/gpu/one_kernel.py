"""Parts of a program that an NVIDIA GPU runs as one kernel.

XLA makes a kernel of each fused operation, and a physics step has some hundred of them, with loops whose every turn the
host has to start. A thread that keeps its world in registers through all steps is many times as fast (see "On an NVIDIA
GPU" in docs/decisions/engine.md).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp

from iphyre_jax.execution.gpu.row_by_row import evaluate
from iphyre_jax.execution.gpu.rows import LANES, has_lanes, spread, values
from iphyre_jax.execution.layout import Layout

Tree = TypeVar("Tree")

OLDEST: Final = "8.0"  # compute capability for which XLA has Triton
# What JAX raises where it has no such backend, or a backend without what a kernel needs.
_REASONS: Final = (AttributeError, ImportError, KeyError, NotImplementedError, TypeError, ValueError)
BLOCK: Final = 32  # lanes of a block, the threads of one warp: "any lane" means one of these


class NoKernelError(Exception):
    """No kernel can be made here; a warning has said so."""


def in_one_kernel(work: Callable[..., Tree], shared: Any, tables: Any) -> Tree:  # noqa: ANN401 - trees of arrays
    """Return work(shared, tables); on an NVIDIA GPU as one kernel; traced.

    Args:
        work: returns a tree of arrays with lanes. Lane k of them depends on `shared` and on lane k of `tables` alone.
            It takes nothing traced from around it. Its derivatives are those of the plain form.
        shared: a tree of arrays without lanes.
        tables: a tree of arrays, (..., lanes).
    """
    if not kernels_run():
        return work(shared, tables)
    try:
        return _with_derivatives(work, partial(kernel, work))(shared, tables)
    except _REASONS as error:
        plain = work(shared, tables)  # if the work itself is wrong, it says so
        _warn(error)
        return plain


def blocks_in_one_kernel(
    works: Sequence[Callable[..., Tree]],
    chosen: jax.Array,
    shared: Any,  # noqa: ANN401
    tables: Any,  # noqa: ANN401
) -> Tree:
    """Return what works make of blocks of lanes; on an NVIDIA GPU all blocks side by side in one kernel; traced.

    Args:
        works: as in `in_one_kernel`; their results have the same shapes.
        chosen: (blocks,) int32, the work of each block of BLOCK lanes.
        shared: a tree of arrays without lanes.
        tables: a tree of arrays, (..., blocks * BLOCK).

    Raises:
        NoKernelError: on an NVIDIA GPU, where no kernel can be made. Block by block would take far longer there than
            work by work.
    """

    def one_by_one(chosen: jax.Array, shared: Any, tables: Any) -> Tree:  # noqa: ANN401
        blocks = chosen.shape[0]
        split = jax.tree.map(lambda leaf: jnp.moveaxis(leaf.reshape(*leaf.shape[:-1], blocks, BLOCK), -2, 0), tables)
        parts: Tree = jax.lax.map(lambda block: jax.lax.switch(block[0], works, shared, block[1]), (chosen, split))
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -2).reshape(*leaf.shape[1:-1], blocks * BLOCK), parts)

    def one_of(number: jax.Array, shared: Any, tables: Any) -> Tree:  # noqa: ANN401
        result: Tree = jax.lax.switch(number, works, shared, tables)
        return result

    def as_kernel(chosen: jax.Array, shared: Any, tables: Any) -> Tree:  # noqa: ANN401
        return kernel(one_of, shared, tables, chosen=chosen)

    if not kernels_run():
        return one_by_one(chosen, shared, tables)
    try:
        return _with_derivatives(one_by_one, as_kernel)(chosen, shared, tables)
    except _REASONS as error:
        _warn(error)
        raise NoKernelError from error


def kernels_run() -> bool:
    """Return whether JAX's default backend is a GPU for which XLA has Triton."""
    if jax.default_backend() != "gpu":
        return False
    device = jax.devices()[0]
    generation = int(getattr(device, "compute_capability", OLDEST).partition(".")[0])
    return device.device_kind.startswith("NVIDIA") and generation >= int(OLDEST.partition(".")[0])


def _warn(error: Exception) -> None:
    reason = f"{type(error).__name__}: {error}"
    text = f"this version of JAX makes no kernel of the physics ({reason}); steps take many times as long"
    warnings.warn(text, RuntimeWarning, stacklevel=3)


def _with_derivatives(plain: Callable[..., Tree], as_kernel: Callable[..., Tree]) -> Callable[..., Tree]:
    """Return a kernel whose derivatives are those of its plain form, and which is plain in a program for a CPU."""
    run: Callable[..., Tree] = jax.custom_jvp(
        lambda *given: jax.lax.platform_dependent(*given, cuda=as_kernel, default=plain)
    )

    def derivative(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Tree, Tree]:
        both: tuple[Tree, Tree] = jax.jvp(plain, primals, tangents)
        return both

    run.defjvp(derivative)  # type: ignore[attr-defined]
    return run


def kernel(
    work: Callable[..., Tree],
    shared: Any,  # noqa: ANN401
    tables: Any,  # noqa: ANN401
    *,
    chosen: jax.Array | None = None,
    interpret: bool = False,
) -> Tree:
    """Do what `in_one_kernel` does.

    Args:
        work: takes the number of its block first, if there are any.
        shared: a tree of arrays without lanes.
        tables: a tree of arrays, (..., lanes).
        chosen: (blocks,) int32, a number of each block of lanes; None for none.
        interpret: without a GPU, for tests.

    Raises:
        NotImplementedError: the work has an operation that `row_by_row` does not know.
    """
    from jax.experimental import pallas as pl  # takes a second to import
    from jax.experimental.pallas import triton

    shared, tables = jax.tree.map(jnp.asarray, (shared, tables))
    of_shared, lanes = jax.tree.leaves(shared), jax.tree.leaves(tables)[0].shape[-1]
    dtype = "float64" if any(leaf.dtype.itemsize == 8 for leaf in jax.tree.leaves((shared, tables))) else "float32"
    of_block = [] if chosen is None else [jax.ShapeDtypeStruct((), chosen.dtype)]
    work = jax.jit(work)  # traced once, not for its shapes too
    given = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((*leaf.shape[:-1], LANES), leaf.dtype), tables)
    given_shared = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), shared)
    results = jax.eval_shape(work, *of_block, given_shared, given)
    if not all(has_lanes(out.shape) for out in jax.tree.leaves(results)):
        raise NotImplementedError("a result without lanes in a kernel")
    layout, layout_of_results = _layout(given, dtype), _layout(results, dtype)

    def in_words(*arguments: Any) -> jax.Array:  # noqa: ANN401
        *first, table = arguments
        return layout_of_results.pack(_widened(work(*first, _narrowed(layout.unpack(table), given)), dtype))

    jaxpr = jax.make_jaxpr(in_words)(*of_block, given_shared, jax.ShapeDtypeStruct((layout.rows, LANES), layout.word))

    def body(*refs: Any) -> None:  # noqa: ANN401 - references of Pallas
        words, *others, written = refs
        arguments = [
            values(leaf.shape, [ref[k] for k in range(leaf.size)])
            for leaf, ref in zip([*of_block, *of_shared], others, strict=True)
        ]
        rows = values((layout.rows,), _read_rows(words, layout.rows))
        (done,) = evaluate(jaxpr, [*arguments, rows], BLOCK, pl.program_id(0) >> 30)
        _write_rows(written, [spread(number, layout.word, BLOCK) for number in done])

    blocks, room = -(-lanes // BLOCK), _room(layout_of_results.rows)
    table = jnp.pad(layout.pack(_widened(tables, dtype)), ((0, 0), (0, -lanes % BLOCK)), mode="edge")
    table = jnp.pad(table, ((0, _room(layout.rows) - layout.rows), (0, 0)))
    call = pl.pallas_call(
        body,
        grid=(blocks,),
        in_specs=[
            pl.BlockSpec((table.shape[0], BLOCK), lambda k: (0, k)),
            *(pl.BlockSpec((1,), lambda k: (k,)) for _ in of_block),
            *(pl.BlockSpec((leaf.size,), lambda _: (0,)) for leaf in of_shared),
        ],
        out_specs=pl.BlockSpec((room, BLOCK), lambda k: (0, k)),
        out_shape=jax.ShapeDtypeStruct((room, blocks * BLOCK), layout.word),
        compiler_params=None if interpret else triton.CompilerParams(num_warps=1, num_stages=1),
        interpret=interpret,
        name="physics",
    )
    written = call(table, *([] if chosen is None else [chosen]), *map(jnp.ravel, of_shared))
    left: Tree = _narrowed(layout_of_results.unpack(written[: layout_of_results.rows, :lanes]), results)
    return left


def _layout(tree: Any, dtype: str) -> Layout:  # noqa: ANN401
    """Return the layout of a tree of arrays with lanes, all of whose floating-point numbers are of one type."""

    def without_lanes(leaf: Any) -> jax.ShapeDtypeStruct:  # noqa: ANN401
        return jax.ShapeDtypeStruct(leaf.shape[:-1], dtype if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf.dtype)

    return Layout.of(jax.tree.map(without_lanes, tree), dtype)


def _widened(tree: Tree, dtype: str) -> Tree:
    """Return a tree whose floating-point numbers are all of one type, the widest; a layout knows no other."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, tree)


def _narrowed(tree: Any, like: Any) -> Any:  # noqa: ANN401
    """Return a tree with the types of another."""
    return jax.tree.map(lambda leaf, kind: leaf.astype(kind.dtype), tree, like)


def _room(rows: int) -> int:
    """Return the rows of a table with room for so many: a power of two, as Triton's arrays have."""
    return 1 << (rows - 1).bit_length()


def _read_rows(ref: Any, rows: int) -> list[jax.Array]:  # noqa: ANN401
    """Return the rows of a table, (BLOCK,) each.

    They are read at once and then taken apart: the time to compile grows with reads times operations.
    """
    pieces = jax.lax.split(ref[...], (1,) * ref.shape[0], 0)
    return [row.reshape(BLOCK) for row in pieces[:rows]]


def _write_rows(ref: Any, rows: Sequence[jax.Array]) -> None:  # noqa: ANN401
    """Write rows of (BLOCK,) into a table, at once."""
    blank = jnp.zeros((BLOCK,), rows[0].dtype)
    ref[...] = _joined([*rows, *[blank] * (ref.shape[0] - len(rows))]).reshape(BLOCK, ref.shape[0]).T


def _joined(rows: Sequence[jax.Array]) -> jax.Array:
    """Stack rows, a power of two of them, behind; the last of the axes tells even rows from odd ones."""
    return rows[0] if len(rows) == 1 else jnp.stack([_joined(rows[::2]), _joined(rows[1::2])], -1)

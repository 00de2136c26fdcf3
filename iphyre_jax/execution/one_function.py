"""Parts of a program that a CPU runs as one function of machine code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata

Tree = TypeVar("Tree")

# Of a call. XLA sets the first one itself, on small loops; the second keeps the call from being inlined before that.
ATTRIBUTES: Final[Mapping[str, str]] = {"xla_cpu_small_call": "true", "inlineable": "false"}


def in_one_function(work: Callable[..., Tree], *arguments: Any, in_place: tuple[Any, ...] = ()) -> Tree:  # noqa: ANN401
    """Return work(*arguments, *in_place); on a CPU it is compiled into one function; traced.

    Otherwise a CPU runs a kernel for each fused operation, one after the other, and a physics step has some hundred.

    Args:
        work: returns a tree of arrays. It has no sort, call of the host or exchange between devices, and no scatter but
            of one row: XLA refuses to compile them into a function. It is neither batched nor differentiated.
        arguments: trees of arrays.
        in_place: trees of arrays that `work` takes too, and changes without a copy. It must read each of them, and
            neither overwrite it whole nor return it as it is, whatever the compiler finds out.
    """
    if jax.default_backend() != "cpu":
        return work(*arguments, *in_place)
    leaves: list[jax.Array]
    leaves, structure = jax.tree.flatten((*arguments, *in_place))
    filled = [leaf for leaf in leaves if leaf.size]  # an array without numbers cannot be used, see below
    kept = sum(leaf.size > 0 for leaf in jax.tree.leaves(arguments))

    def call(*filled: jax.Array) -> tuple[jax.Array, Tree]:
        given = iter(filled)
        every = [next(given) if leaf.size else jnp.zeros(leaf.shape, leaf.dtype) for leaf in leaves]
        # jaxlib 0.10.2 ends the process if the function leaves an argument unused. So a number of each is used. Of an
        # array that is changed in place it would be read too late, so that XLA copies the array.
        used = sum((leaf[(0,) * leaf.ndim].astype(jnp.int32) for leaf in filled[:kept]), jnp.int32(0))
        return used, work(*jax.tree.unflatten(structure, every))

    used, result = jax.jit(call)(*filled)
    result = set_xla_metadata(result, **ATTRIBUTES)  # the mark of a result is that of the call
    # The barrier keeps `used`, which JAX would drop.
    _, result = jax.lax.optimization_barrier((used, result))
    return result


def in_branch(always: jax.Array, work: Callable[[], Tree]) -> Tree:
    """Return work(), on a CPU computed in a branch; traced.

    So its results are there before anything that needs them, also in our compiler processes. And if a program is spread
    over devices, XLA does not inline the calls inside. Elsewhere `physics.lanes.materialize` does it, without a
    condition. An optimization barrier does not keep a CPU's compiler from computing what results share anew.

    Args:
        always: () bool, True, which the compiler must not know.
        work: returns a tree of arrays.
    """
    if jax.default_backend() != "cpu":
        return work()
    work = jax.jit(work)  # traced once, not for its shapes too
    blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(work))
    return jax.lax.cond(always, work, lambda: blank)

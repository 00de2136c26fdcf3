"""JAX's options that decide numbers, at their defaults: trained networks have the same bits in any process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import jax


@contextmanager
def default_options() -> Iterator[None]:
    """Work with JAX's defaults, for this thread: a context, or a decorator of a function.

    Programs in float64 set x64 themselves, around their own calls.
    """
    with ExitStack() as stack:
        for option in (
            jax.enable_x64(False),
            jax.default_prng_impl("threefry2x32"),
            jax.threefry_partitionable(True),
            jax.default_matmul_precision(None),
            jax.numpy_dtype_promotion("standard"),
            jax.numpy_rank_promotion("allow"),
        ):
            stack.enter_context(option)
        yield

"""Programs to be linked are compiled and tried out here, in a process that does nothing but compile.

If a jaxlib has other formats than we know, or a program reads more rows of a table than it should, this process ends,
and not the user's.
"""

from __future__ import annotations

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.execution.compilation.client import serialized
from iphyre_jax.execution.machine_code.linked import MOST_ROWS, LinkedProgram
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.execution.programs import InPlaceProgram
from iphyre_jax.physics.lanes import read, write

ROWS, COLUMNS = 9, 48


def compile_in_place(program: InPlaceProgram) -> bytes:
    """Return the executable of a program, serialised, after its example was played.

    Raises:
        ValueError: it cannot be linked; one line. OSError: see `LinkedProgram`.
    """
    check_linking()
    arguments = program.arguments()
    changed = range(len(arguments) - program.in_place, len(arguments))
    lowered = jax.jit(program.run, keep_unused=True, donate_argnums=tuple(changed)).lower(*arguments)
    payload = serialized(lowered.compile())
    jax.block_until_ready(jax.jit(LinkedProgram(payload, program.in_place))(*program.example()))
    return payload


@cache
def check_linking() -> None:
    """Compile a small program, link it, and call it with fewer rows than it was compiled for.

    Raises:
        ValueError: it returns something else than XLA's own program; one line. Other errors: see `LinkedProgram`.
    """
    with jax.enable_x64(False):
        step, rows = jnp.arange(COLUMNS, dtype=jnp.float32), jnp.array([ROWS - 1], jnp.int32)
        table, whole = jnp.ones((ROWS, COLUMNS)), jax.ShapeDtypeStruct((MOST_ROWS, COLUMNS), jnp.float32)
        compiled = jax.jit(_play, donate_argnums=2, keep_unused=True).lower(step, rows, whole).compile()
        program = LinkedProgram(serialized(compiled), 1)
        (found,), (expected,) = jax.jit(program)(step, rows, table), _play(step, rows, table)
    if not np.array_equal(found, expected):
        raise ValueError("linked program: expected the results of XLA's own")


def _play(step: jax.Array, rows: jax.Array, table: jax.Array) -> tuple[jax.Array]:
    """Change some rows of a table: a loop with constants, memory of its own, and a function of the C library.

    Nothing is rounded, so that it does not matter how it is compiled.
    """

    def play(step: jax.Array, rows: jax.Array, table: jax.Array) -> jax.Array:
        weights = jnp.asarray(2.0 ** (np.arange(COLUMNS, dtype=np.float32) % 5))

        def change(k: jax.Array, table: jax.Array) -> jax.Array:
            row = read(table, k)
            return write(table, k, jnp.where(jnp.sin(step * k) > 0, row * weights, row - weights))

        return jax.lax.fori_loop(0, rows[0], change, table)

    return (in_one_function(play, step, rows, in_place=(table,)),)

"""Parts of programs as one function of machine code, and rows that stay on their devices."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.execution.one_function import in_branch, in_one_function


def functions(program: jax.stages.Compiled) -> int:
    """Return how many calls of a program are functions by our wish; XLA makes others of small loops."""
    return sum(" call(" in line and 'inlineable="false"' in line for line in program.as_text().splitlines())


def collatz(start: jax.Array, limit: jax.Array, unused: jax.Array, empty: jax.Array, flag: jax.Array) -> jax.Array:
    """Loops within a loop, and arguments that nobody reads."""
    del unused, flag

    def steps(k: jax.Array) -> jax.Array:
        def turn(now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            return jnp.where(now[0] % 2 == 0, now[0] // 2, 3 * now[0] + 1), now[1] + 1

        return jax.lax.while_loop(lambda now: now[0] > 1, turn, (k, jnp.int32(0)))[1]

    counts = jax.lax.fori_loop(0, limit, lambda k, out: out.at[k].set(steps(start + k)), jnp.zeros(30, jnp.int32))
    return counts + empty.size


def of_27(k: int) -> int:
    steps, now = 0, 27 + k
    while now > 1:
        now, steps = now // 2 if now % 2 == 0 else 3 * now + 1, steps + 1
    return steps


@pytest.mark.parametrize("constant", [False, True])
def test_the_function_gives_what_its_work_gives(constant: bool) -> None:
    """Whether its arguments are known to the compiler or not, and none of them has to be read."""
    given = jnp.int32(27), jnp.int32(30), jnp.ones((3, 2)), jnp.zeros((0, 4)), jnp.array(True)

    def whole(*arguments: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
        used = given if constant else arguments
        return in_one_function(lambda *own: (collatz(*own), {"twice": own[0] * 2}), *used)

    program = jax.jit(whole).lower(*given).compile()
    counts, rest = program(*given)
    np.testing.assert_array_equal(counts, [of_27(k) for k in range(30)])
    assert rest["twice"] == 54
    assert functions(program) == 1


def test_results_that_nobody_reads_do_not_matter() -> None:
    """The function stays one, whichever of its results is read."""

    def whole(number: jax.Array) -> jax.Array:
        _, read, _ = in_one_function(lambda number: (number + 1, number + 2, number.sum()), number)
        return read

    program = jax.jit(whole).lower(jnp.arange(3.0)).compile()
    np.testing.assert_array_equal(program(jnp.arange(3.0)), [2, 3, 4])
    assert functions(program) == 1
    with jax.disable_jit():
        np.testing.assert_array_equal(whole(jnp.arange(3.0)), [2, 3, 4])


def test_arrays_in_place_are_not_copied() -> None:
    """In a loop whose turns are functions that write a few rows of a table."""
    size = 1000

    def whole(table: jax.Array, in_place: bool) -> jax.Array:
        def rows(scale: jax.Array, k: jax.Array, table: jax.Array) -> jax.Array:
            def row(i: jax.Array, table: jax.Array) -> jax.Array:
                own = jax.lax.dynamic_slice_in_dim(table, 10 * k + i, 1)
                return jax.lax.dynamic_update_slice_in_dim(table, own * scale, 10 * k + i, 0)

            return jax.lax.fori_loop(0, 10, row, table)

        def turn(k: jax.Array, table: jax.Array) -> jax.Array:
            arguments = jnp.float32(3), k
            if in_place:
                return in_one_function(rows, *arguments, in_place=(table,))
            return in_one_function(rows, *arguments, table)

        return jax.lax.fori_loop(0, 5, turn, table)

    table = np.arange(2.0 * size, dtype=np.float32).reshape(size, 2)
    expected = np.where(np.arange(size)[:, None] < 50, 3 * table, table)
    copies = []
    for in_place in (False, True):
        program = jax.jit(whole, static_argnums=1, donate_argnums=0).lower(jnp.asarray(table), in_place).compile()
        np.testing.assert_array_equal(program(jnp.asarray(table)), expected)
        copies.append(program.as_text().count(f"f32[{size},2]{{1,0}} copy("))
    assert copies[0] > 0
    assert copies[1] == 0


def test_a_branch_gives_what_its_work_gives() -> None:
    def whole(number: jax.Array) -> tuple[jax.Array, jax.Array]:
        roots = in_branch(number[0] > -1, lambda: {"root": jnp.sqrt(number), "square": number**2})
        return roots["root"].T, roots["square"]

    number = jnp.arange(6.0)
    for given, expected in zip(jax.jit(whole)(number), (np.sqrt(number), number**2), strict=True):
        np.testing.assert_allclose(given, expected, rtol=1e-6)


ROWS = """
import jax, jax.numpy as jnp, numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec
from iphyre_jax.execution.one_function import in_branch, in_one_function
from iphyre_jax.execution.rowwise import rowwise

assert jax.device_count() == 2
mesh = jax.make_mesh((2,), ("rows",), axis_types=(AxisType.Auto,))
own, whole = (NamedSharding(mesh, PartitionSpec(*names)) for names in (["rows"], []))

def slices(table, rows):  # as worlds are played: some rows at a time, one function on each device
    def part(table, rows):
        def one(k, out):
            taken = jax.lax.dynamic_slice_in_dim(rows["x"], k * 2, 2)
            return jax.lax.dynamic_update_slice_in_dim(out, taken @ table, k * 2, 0)
        size = rows["x"].shape[0]
        return jax.lax.fori_loop(0, size // 2, one, jnp.zeros((size, 3))), rows["y"] + 1
    return in_branch(table[0, 0] > -1, lambda: in_one_function(part, table, rows))

table = jnp.arange(12.0).reshape(4, 3)
rows = {"x": jnp.arange(64.0).reshape(16, 4), "y": jnp.arange(16)}
program = jax.jit(lambda table, rows: rowwise(slices, table, rows))
alone = program(table, rows)
spread = jax.device_put(table, whole), jax.device_put(rows, own)
compiled = program.lower(*spread).compile()
told = compiled(*spread)
for one, other in zip(told, alone):
    np.testing.assert_array_equal(one, other)
    assert one.sharding.spec == PartitionSpec("rows"), one.sharding
np.testing.assert_array_equal(alone[0], np.asarray(rows["x"]) @ np.asarray(table))
text = compiled.as_text()
assert not any(exchange in text for exchange in ("all-gather", "all-reduce", "all-to-all", "collective-permute")), text
assert sum(" call(" in line and "inlineable" in line for line in text.splitlines()) == 1, text
print("done")
"""


def test_each_device_does_its_own_rows() -> None:
    """Two devices of a CPU, in a process of their own: nothing is exchanged, and each has one function."""
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    done = subprocess.run([sys.executable, "-c", ROWS], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "done", done.stderr

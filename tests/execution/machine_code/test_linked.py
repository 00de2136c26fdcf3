"""Programs that are compiled apart and linked into those of the user: Linux on x86-64."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax._src import compilation_cache

from iphyre_jax.execution.compilation.client import serialized
from iphyre_jax.execution.machine_code import kernel, linked, trial
from iphyre_jax.execution.machine_code.kernel import Kernel, Memory
from iphyre_jax.execution.machine_code.linked import MOST_ROWS, LinkedProgram
from iphyre_jax.execution.machine_code.linking import can_link
from iphyre_jax.execution.one_function import in_one_function
from iphyre_jax.physics.lanes import materialize, read, write

pytestmark = pytest.mark.skipif(not can_link(), reason="links on Linux with x86-64")
COLUMNS = 24


def change(weights: jax.Array, count: jax.Array, table: jax.Array, sums: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Change the first rows of a table, and write their sums; constants, memory of its own, functions of libm."""

    def work(weights: jax.Array, count: jax.Array, table: jax.Array, sums: jax.Array) -> tuple[jax.Array, jax.Array]:
        steps = jnp.asarray(np.geomspace(1, 2, COLUMNS, dtype=np.float32))

        def row(k: jax.Array, tables: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            table, sums = tables
            new = materialize(lambda: jnp.sin(read(table, k) * weights + steps))
            return write(table, k, new), write(sums, k, new.sum())

        return jax.lax.fori_loop(0, count, row, (table, sums))

    return in_one_function(work, weights, count, in_place=(table, sums))


def given(rows: int, seed: int = 0) -> tuple[jax.Array, jax.Array, jax.Array]:
    rng = np.random.default_rng(seed)
    parts = rng.random(COLUMNS, np.float32), np.int32(rows), rng.random((rows, COLUMNS), np.float32)
    return tuple(map(jnp.asarray, parts))  # type: ignore[return-value]


@pytest.fixture(scope="module", autouse=True)
def compiled_here() -> Iterator[None]:
    """An executable from JAX's own cache has no object file; compiler processes have no such cache."""
    with pytest.MonkeyPatch.context() as patch:  # JAX looks at its setting only once, before the first program
        patch.setattr(compilation_cache, "_cache_checked", True)
        patch.setattr(compilation_cache, "_cache_used", False)
        yield


def payload_of(function: Any, *shapes: Any, donated: tuple[int, ...] = ()) -> bytes:
    return serialized(jax.jit(function, donate_argnums=donated, keep_unused=True).lower(*shapes).compile())


@pytest.fixture(scope="module")
def payload() -> bytes:
    numbers, table = jax.ShapeDtypeStruct((COLUMNS,), "float32"), jax.ShapeDtypeStruct((MOST_ROWS, COLUMNS), "float32")
    sums = jax.ShapeDtypeStruct((MOST_ROWS,), "float32")
    return payload_of(change, numbers, jax.ShapeDtypeStruct((), "int32"), table, sums, donated=(2, 3))


def expected(rows: int, seed: int = 0) -> tuple[jax.Array, jax.Array]:
    return jax.jit(change)(*given(rows, seed), jnp.zeros(rows))


def test_the_trial_passes() -> None:
    trial.check_linking.__wrapped__()


def test_the_trial_finds_another_result(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if a constant's number had another field."""
    monkeypatch.setattr(kernel, "_literal", lambda literal: bytes(4 * max(literal.number(4), trial.COLUMNS)))
    monkeypatch.setattr(linked, "_registered", set())
    with pytest.raises(ValueError, match="expected"):
        trial.check_linking.__wrapped__()


@pytest.mark.parametrize("rows", [1, 7, 500])
def test_results_are_those_of_xla_for_any_number_of_rows(payload: bytes, rows: int) -> None:
    """The sums are only written: a shape stands in their place."""
    program = LinkedProgram(payload, 2)
    sums = jax.ShapeDtypeStruct((rows,), "float32")
    found = jax.jit(lambda *given: program(*given, sums))(*given(rows))
    for one, other in zip(found, expected(rows), strict=True):
        np.testing.assert_array_equal(one, other)


def test_an_argument_that_is_read_afterwards_keeps_its_numbers(payload: bytes) -> None:
    program = LinkedProgram(payload, 2)
    weights, count, table = given(9)
    (new, _), old = jax.jit(lambda table: (program(weights, count, table, jnp.zeros(9)), table))(table)
    np.testing.assert_array_equal(old, given(9)[2])
    np.testing.assert_array_equal(new, expected(9)[0])


def test_a_loop_of_the_user_changes_its_table_in_place(payload: bytes) -> None:
    program, turns = LinkedProgram(payload, 2), 5
    weights, count, table = given(9)

    def turn(table: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        new, sums = program(weights, count, table, jax.ShapeDtypeStruct((9,), "float32"))
        return new, sums

    compiled = jax.jit(lambda table: jax.lax.scan(turn, table, length=turns)).lower(table).compile()
    last, sums = compiled(table)
    for k in range(turns):
        table, own = jax.jit(change)(weights, count, table, jnp.zeros(9))
        np.testing.assert_array_equal(sums[k], own)
    np.testing.assert_array_equal(last, table)


def test_threads_call_one_program_at_once(payload: bytes) -> None:
    program = LinkedProgram(payload, 2)
    sums = jax.ShapeDtypeStruct((300,), "float32")
    call = jax.jit(lambda *given: program(*given, sums))
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda seed: [call(*given(300, seed)) for _ in range(20)], range(4)))
    for seed, runs in enumerate(found):
        for tables in runs:
            for one, other in zip(tables, expected(300, seed), strict=True):
                np.testing.assert_array_equal(one, other)


def test_what_a_kernel_gets(payload: bytes) -> None:
    found = Kernel.of(payload)
    assert found.in_place == (2, 3)
    assert {buffer.number for buffer in found.buffers if buffer.memory is Memory.PARAMETER} == {0, 1, 2, 3}
    assert np.geomspace(1, 2, COLUMNS, dtype=np.float32).tobytes() in found.constants
    assert found.scratch_size > 0


def test_a_copy_of_a_whole_table_is_refused() -> None:
    """It would read behind a table of fewer rows."""

    def work(count: jax.Array, table: jax.Array) -> jax.Array:
        """A row is read for two purposes."""

        def turn(k: jax.Array, tables: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            table, total = tables
            new = read(table, k) + 1
            return write(table, k, new), total + new.sum()

        table, total = jax.lax.fori_loop(0, count, turn, (table, jnp.float32(0)))
        return write(table, 0, total + read(table, 0))

    shapes = jax.ShapeDtypeStruct((), "int32"), jax.ShapeDtypeStruct((MOST_ROWS, COLUMNS), "float32")
    payload = payload_of(lambda count, table: (in_one_function(work, count, in_place=(table,)),), *shapes, donated=(1,))
    with pytest.raises(ValueError, match="a copy of a whole table"):
        LinkedProgram(payload, 1)


def test_other_programs_are_refused(payload: bytes) -> None:
    row = jax.ShapeDtypeStruct((COLUMNS,), "float32")
    with pytest.raises(ValueError, match="expected 1 results in place"):
        LinkedProgram(payload, 1)
    several = payload_of(lambda row: (jnp.sort(row), jnp.sin(row).sum()), row)
    for other in (several, payload[:100], b"", b"\x01" * 40):
        with pytest.raises(ValueError, match="expected") as raised:
            LinkedProgram(other, 1)
        assert "\n" not in str(raised.value)

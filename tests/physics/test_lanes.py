"""Results that are in memory before anything reads them; tables that are filled place by place; rows of any lane."""

from __future__ import annotations

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax import load_scene, physics
from iphyre_jax.execution.compilation.options import OPTIONS, xla_flags
from iphyre_jax.physics import lanes
from iphyre_jax.scenes.compile import compile_scene, step_timing

NUMBERS = np.arange(6.0, dtype=np.float32).reshape(2, 3)


def roots(numbers: jax.Array) -> jax.Array:
    """Two results of one part, both read twice, one of them handed through."""
    same, root = lanes.materialize(lambda: (numbers, jnp.sqrt(numbers)))
    return root.T @ same + same.T @ root


def calls(text: str) -> int:
    return sum("call" in line and "inlineable" in line for line in text.splitlines())


def test_a_part_gives_what_its_work_gives() -> None:
    half = np.sqrt(NUMBERS).T @ NUMBERS
    np.testing.assert_allclose(jax.jit(roots)(NUMBERS), half + half.T, rtol=1e-5)
    with jax.disable_jit():
        np.testing.assert_allclose(roots(jnp.asarray(NUMBERS)), half + half.T, rtol=1e-5)
    many = np.stack([NUMBERS, NUMBERS + 1])
    np.testing.assert_allclose(jax.vmap(roots)(many)[1], roots(many[1]), rtol=1e-5)
    _, slope = jax.jvp(roots, (NUMBERS + 1,), (np.ones_like(NUMBERS),))
    step = np.float32(0.01)
    np.testing.assert_allclose(slope, (roots(NUMBERS + 1 + step) - roots(NUMBERS + 1 - step)) / (2 * step), rtol=1e-2)


def test_it_is_a_call_on_a_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sum(" call(" in line for line in jax.jit(roots).lower(NUMBERS).compile().as_text().splitlines()) == 1
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert calls(jax.jit(lambda numbers: roots(numbers)).lower(NUMBERS).as_text()) == 0


# Shapes, order keys, the pairs of a kind and their contacts, where a contact is kept, a slot. With two kinds more, of
# which bars have two contacts, and the separation of bars; with five bodies in a tree a removal, an insertion and three
# levels.
@pytest.mark.parametrize(("game", "parts"), [("support", 6), ("multi_ball_lever", 6 + 8 + 5)])
def test_a_step_has_its_parts(game: str, parts: int) -> None:
    topology, world = compile_scene(load_scene(game), dtype="float32")
    state, timing = physics.initial_state(topology, world), step_timing(60, "float32")
    lowered = jax.jit(lambda state: physics.step(topology, world, timing, state)).lower(state)
    assert calls(lowered.as_text()) == parts


def test_the_processes_that_compile_need_no_calls() -> None:
    code = "from iphyre_jax.physics import lanes; print(lanes._results_share_loops)"
    for flags, told in ((xla_flags(OPTIONS), "True"), ("", "False")):
        around = {**os.environ, "XLA_FLAGS": flags}
        done = subprocess.run([sys.executable, "-c", code], env=around, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == told


@pytest.mark.parametrize("dtype", ["int32", "float32", "float64"])
def test_a_filled_place_has_the_bits_of_what_fills_it(dtype: str) -> None:
    with jax.enable_x64(dtype == "float64"):
        kind = np.dtype(dtype)
        ends = [np.iinfo(kind).min, np.iinfo(kind).max] if kind.kind == "i" else [-0.0, np.nan, np.inf, -np.inf, 1e-30]
        values = np.array([0, 1, -3, *ends], kind)
        table = lanes.blank(jnp.zeros((3, len(values)), kind))
        for row in (2, 0):
            table = jax.jit(lanes.fill)(table, np.arange(3)[:, None] == row, values[None])
        table = np.asarray(table)
        assert table.dtype == kind
        assert table[[0, 2]].tobytes() == np.stack([values, values]).tobytes()
        assert not table[1].any()


def test_a_filled_place_has_a_derivative() -> None:
    table, here = lanes.blank(jnp.zeros((2, 3), jnp.float32)), np.array([[True], [False]])
    _, slope = jax.jvp(lambda new: lanes.fill(table, here, new), (NUMBERS[:1],), (np.full((1, 3), 2, np.float32),))
    np.testing.assert_array_equal(slope, [[2, 2, 2], [0, 0, 0]])


@pytest.mark.parametrize("rows", [[], [0], [31, 32, 69], [3, 2, 40], range(70)])
def test_rows_that_any_lane_has_set_are_visited_in_their_order(rows: list[int]) -> None:
    flags = np.zeros((70, 3), bool)
    flags[list(rows), [row % 3 for row in rows]] = True

    def note(row: jax.Array, carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        seen, count = carry
        return seen.at[count].set(row), count + 1

    start = jnp.full(70, -1, jnp.int32), jnp.int32(0)
    seen, count = jax.jit(lambda flags: lanes.visit_any(flags, note, start))(flags)
    assert seen[:count].tolist() == sorted(rows)

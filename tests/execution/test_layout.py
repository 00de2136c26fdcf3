"""Tables of words: what goes in comes out, on both sides of the border; and programs as JSON."""

from __future__ import annotations

import json
from typing import Any

import jax
import numpy as np
import pytest

from iphyre_jax import load_scene
from iphyre_jax.execution.compilation.description import describe, from_description
from iphyre_jax.execution.layout import read_columns, write_columns
from iphyre_jax.execution.programs import Score, world_layout
from iphyre_jax.scenes.compile import compile_scene
from tests.trees import assert_equal_trees


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("game", ["hole", "spring_flick", "multi_ball_lever"])
def test_worlds_cross_the_border_whole(game: str, dtype: str) -> None:
    topology, world = compile_scene(load_scene(game), dtype=dtype)
    layout = world_layout(topology, dtype)
    table = layout.pack_many([world, world])
    assert table.shape == (layout.rows, 2)
    stacked = jax.tree.map(lambda leaf: np.stack([leaf, leaf], axis=-1), world)
    assert_equal_trees(layout.unpack_numpy(table), stacked)
    with jax.enable_x64(dtype == "float64"):
        assert_equal_trees(layout.unpack(jax.numpy.asarray(table)), stacked)
        np.testing.assert_array_equal(layout.pack(stacked), table)
    numbers = layout.first_rows().start.x
    np.testing.assert_array_equal(table[numbers : numbers + topology.moving, 0].view(dtype), world.start.x)


def test_bits_that_are_no_numbers_survive() -> None:
    topology, world = compile_scene(load_scene("hole"), dtype="float32")
    layout = world_layout(topology, "float32")
    table = layout.pack_many([world])
    table[layout.whole_rows] = np.float32(np.nan).view(np.int32) | 1
    again = layout.pack_many([jax.tree.map(lambda leaf: leaf[..., 0], layout.unpack_numpy(table))])
    np.testing.assert_array_equal(again, table)


def test_a_program_is_described_as_data() -> None:
    topology, _ = compile_scene(load_scene("pendulum"), dtype="float64")
    program = Score(topology, "float64", 64, 6)
    assert from_description(json.loads(json.dumps(describe(program)))) == program
    with pytest.raises(TypeError, match="expected a dataclass, a tuple"):
        describe(np.zeros(3))


@pytest.mark.parametrize("kind", ["os:system", "subprocess:Popen", "iphyre_jax.simulation:simulate", "nothing", None])
def test_nothing_else_is_made_of_a_description(kind: Any) -> None:
    with pytest.raises(ValueError, match="class: expected a dataclass of iphyre_jax"):
        from_description({"class": kind})


@pytest.mark.parametrize(("columns", "width"), [(5, 3), (120, 110)])
def test_columns_of_rows_go_in_and_out(columns: int, width: int) -> None:
    """Also rows of more than a block; spare lanes read the last row again, and write nothing."""
    rows, count = np.array([4, 0, 6, 6], np.int32), 3
    table = np.random.default_rng(0).random((7, columns), np.float32)
    read = jax.jit(read_columns, static_argnums=2)(table, rows, width)
    np.testing.assert_array_equal(read, table[rows, :width].T)
    new = np.arange(width * len(rows), dtype=np.float32).reshape(width, len(rows))
    expected = table.copy()
    expected[rows[:count], :width] = new[:, :count].T
    np.testing.assert_array_equal(jax.jit(write_columns)(new, table, rows, np.int32(count)), expected)

"""`rollout`: parts that do not fit together are refused, before JAX narrows or mixes them."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

from iphyre_jax import load_scene, rollout
from iphyre_jax.scenes.compile import compile_scene, step_timing

PLAN = np.array([3, -1], np.int32)


@pytest.mark.parametrize(
    ("world", "timing", "x64", "message"),
    [
        (
            "float64",
            "float64",
            False,
            r"world: expected jax.enable_x64\(True\) around float64, or one made with float32",
        ),
        ("float32", "float64", False, r"timing: expected jax.enable_x64\(True\) around float64.*"),
        ("float32", "float64", True, "timing: expected dtype float32, as the world has, got float64"),
    ],
)
def test_number_types_are_never_mixed_or_narrowed(world: str, timing: str, x64: bool, message: str) -> None:
    topology, made = compile_scene(load_scene("support"), dtype=world)
    with jax.enable_x64(x64), pytest.raises(ValueError, match=f"^{message}$|^{message},"):
        rollout(topology, made, step_timing(60, timing), PLAN, np.int32(10))


@pytest.mark.parametrize("steps", [10**9, np.int64(10**9), np.array(10**9), -1])
def test_steps_that_have_a_value_are_looked_at(steps: Any) -> None:
    topology, made = compile_scene(load_scene("support"), dtype="float32")
    with pytest.raises(ValueError, match=r"^steps: expected a whole number of at least 0 and at most \d+, got"):
        rollout(topology, made, step_timing(60, "float32"), PLAN, steps)


def test_numbers_within_a_part_are_of_one_type() -> None:
    topology, made = compile_scene(load_scene("support"), dtype="float32")
    mixed = dataclasses.replace(made, start=dataclasses.replace(made.start, x=np.float64(made.start.x)))
    with jax.enable_x64(True), pytest.raises(ValueError, match=r"^world: expected dtype float"):
        rollout(topology, mixed, step_timing(60, "float32"), PLAN, np.int32(10))


@pytest.mark.slow
def test_a_world_of_its_own_type_is_played() -> None:
    for dtype in ("float32", "float64"):
        topology, made = compile_scene(load_scene("support"), dtype=dtype)
        with jax.enable_x64(dtype == "float64"):
            out: Any = jax.jit(rollout, static_argnums=0)(topology, made, step_timing(60, dtype), PLAN, np.int32(10))
        assert (int(out.steps), int(out.eliminations)) == (10, 1)


@pytest.mark.slow
def test_steps_beyond_32_bits_are_never_reached() -> None:
    """JAX cuts NumPy's numbers to 32 bits: 2**32 would remove the block at once."""
    topology, made = compile_scene(load_scene("support"), dtype="float32")
    timing = step_timing(60, "float32")
    for late in (2**31, 2**32, 2**33 + 7, 2**40):
        out = rollout(topology, made, timing, np.array([3, late]), np.int32(10))  # type: ignore[arg-type]
        assert int(out.eliminations) == 1
    plan = np.array([2, 5], np.uint8)
    assert int(rollout(topology, made, timing, plan, np.int32(10)).eliminations) == 2  # type: ignore[arg-type]

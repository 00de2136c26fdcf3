"""Results that are in memory before anything reads them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from iphyre_jax.execution.compilation.options import OPTIONS, xla_flags
from iphyre_jax.physics import lanes

NUMBERS = np.arange(6.0, dtype=np.float32).reshape(2, 3)


def roots(numbers: jax.Array) -> jax.Array:
    """Two results of one part, both read twice, one of them handed through."""
    root, same = lanes.materialize(lambda: (jnp.sqrt(numbers), numbers))
    return root.T @ same + same.T @ root


def calls(numbers: np.ndarray) -> int:
    lines = jax.jit(lambda numbers: roots(numbers)).lower(numbers).compile().as_text().splitlines()
    return sum(" call(" in line and 'inlineable="false"' in line for line in lines)


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


def test_it_is_a_call_unless_results_share_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    assert calls(NUMBERS) == 1
    assert lanes.MULTI_OUTPUT_FUSION in xla_flags(OPTIONS)  # of the processes that compile
    monkeypatch.setattr(lanes, "_results_share_loops", True)
    assert calls(NUMBERS) == 0

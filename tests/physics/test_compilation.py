"""How often programs are compiled, in which types, and from which threads."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
import pytest

from iphyre_jax import Simulation, programs, rollouts, simulate, simulate_many


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Forget all programs; the list takes the topology of each one that is traced from now on."""
    seen: list[Any] = []
    whole = rollouts.advance

    def advance(topology: Any, *arguments: Any) -> rollouts.Progress:
        seen.append(topology)
        return whole(topology, *arguments)

    monkeypatch.setattr(rollouts, "advance", advance)
    monkeypatch.setattr(programs, "_PROGRAMS", {})
    monkeypatch.setattr(programs, "_LOCKS", {})
    return seen


@pytest.fixture(params=[False, True], ids=["x64 off", "x64 on"])
def flag(request: pytest.FixtureRequest) -> Iterator[bool]:
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", request.param)
    yield request.param
    jax.config.update("jax_enable_x64", before)


def test_one_program_for_a_topology(traced: list[Any]) -> None:
    """Two scenes, two rates, lengths, sizes of batch, numbers of the reset, sampled or not: traced once."""
    never = [[-1]]
    simulate("hole", never, fps=10)
    simulate("support", never * 3, fps=60, duration=2)
    simulate("hole", never * 200, fps=10, duration=3, sample_every=7)
    simulate("direction", [[0, 1, 2, 3]], fps=25, resets=2)
    simulate_many(["hole", "hinder"], [0, 1, 0], never * 3, fps=60, duration=1)
    assert len(traced) == 1
    simulate("hole", never, fps=10, duration=1, dtype="float64")
    assert len(traced) == 2
    simulate("support", never, fps=60, duration=1, dtype="float64")
    assert len(traced) == 2


def test_types_do_not_depend_on_the_callers_flag_nor_change_it(flag: bool, traced: list[Any]) -> None:
    """Both types, compiled and played, with the flag as it was after each."""
    plan = [[20, 5, 30, 9]]
    for dtype in ("float64", "float32"):
        played = simulate("hole", plan, fps=10, dtype=dtype, sample_every=150)
        assert jax.config.jax_enable_x64 == flag
        assert jax.numpy.zeros(()).dtype == ("float64" if flag else "float32")
        assert played.samples is not None
        assert played.samples.dtype == dtype
        assert played.reward.dtype == np.float64
        expected = _ONCE.setdefault(dtype, played)
        np.testing.assert_array_equal(played.samples, expected.samples)
        np.testing.assert_array_equal(played.steps, expected.steps)
    assert len(traced) == 2


_ONCE: dict[str, Simulation] = {}


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_float64_is_more_than_float32_written_wide(dtype: str) -> None:
    played = simulate("hole", [[-1]], fps=60, duration=2, dtype=dtype, sample_every=120)
    assert played.samples is not None
    ball = played.samples[0, -1, -1].astype(np.float64)
    narrow = ball.astype(np.float32).astype(np.float64)
    assert (ball == narrow).all() == (dtype == "float32")


def test_calls_from_threads_give_what_one_thread_gives(traced: list[Any]) -> None:
    """Eight at once, of both types, none compiled before: each program is still compiled once."""
    plan = np.random.default_rng(0).integers(-1, 80, (8, 40, 4))

    def play(k: int) -> Simulation:
        return simulate("hole", plan[k], fps=10, dtype=("float32", "float64")[k % 2], sample_every=50)

    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(play, range(8)))
    assert len(traced) == 2
    for k, one in enumerate(together):
        alone = play(k)
        np.testing.assert_array_equal(one.steps, alone.steps)
        np.testing.assert_array_equal(one.samples, alone.samples)
        np.testing.assert_array_equal(one.reward, alone.reward)


def test_calls_inside_the_callers_own_contexts() -> None:
    """A caller's x64 context or disabled jit is his own; it neither leaks in nor is left changed."""
    plan = [[20, 5, 30, 9]]
    plain = simulate("hole", plan, fps=10, dtype="float32", sample_every=150)
    with jax.enable_x64(True):
        wide = simulate("hole", plan, fps=10, dtype="float32", sample_every=150)
        assert jax.numpy.zeros(()).dtype == "float64"
    np.testing.assert_array_equal(wide.samples, plain.samples)

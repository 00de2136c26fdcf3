"""A sample of the parity run for what the golden files leave out: unseen layouts, float32, used spaces."""

from collections.abc import Callable
from contextlib import AbstractContextManager

import pytest

from iphyre_jax import SPLITS
from parity.play import GameResult, Task, compare_scenes
from parity.reports.summary import summarise
from parity.tolerances import SAMPLE_FLOAT32_FLAG, SAMPLE_SHARES, TARGETS

PLANS = 3  # plan 0 does nothing
SEED = 0


def compared(names: tuple[str, ...], dtypes: tuple[str, ...], resets: int = 1, plans: int = PLANS) -> list[GameResult]:
    return compare_scenes(Task(names, plans, (60, 10), dtypes, resets, SEED))


def check(results: list[GameResult]) -> None:
    for fps, dtype in {(result.fps, result.dtype) for result in results}:
        chosen = [result for result in results if (result.fps, result.dtype) == (fps, dtype)]
        row = summarise(f"{fps} fps, {dtype}", [result.comparison for result in chosen])
        diverged = [r.game for r in chosen if (r.comparison.error > TARGETS[dtype, fps].error).any()]
        assert row.faults == 0
        assert row.within(TARGETS[dtype, fps].error) >= SAMPLE_SHARES[dtype], (row, diverged)
        if dtype == "float64":
            assert (row.same_flag, row.same_step, row.same_bookkeeping) == (1.0, 1.0, 1.0), row
        else:
            assert row.same_flag >= SAMPLE_FLOAT32_FLAG, row


@pytest.mark.slow
def test_a_sample_of_the_unseen_layouts_agrees() -> None:
    check(compared(SPLITS["unseen_basic"], ("float64",)))


@pytest.mark.slow
def test_a_sample_agrees_in_float32() -> None:
    check(compared(SPLITS["basic"], ("float32",)))


@pytest.mark.slow
@pytest.mark.parametrize("resets", [2, pytest.param(3, marks=pytest.mark.further)])
def test_games_that_depend_on_the_reset_agree_in_a_used_space(
    resets: int, quickly: Callable[[], AbstractContextManager[None]]
) -> None:
    """Few optimisations, as in `test_golden`: `make parity` plays them as users do."""
    with quickly():
        check(compared(("multi_ball_lever", "multi_ball_angle"), ("float64",), resets, plans=6))

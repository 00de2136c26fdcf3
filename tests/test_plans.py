"""Plans in seconds against a literal, slow copy of what the two official drivers do."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from iphyre_jax.plans import official_clock, plan_to_steps, steps_to_times

Floats = npt.NDArray[np.floating[Any]]


def simulate_driver(row: Floats, fps: int) -> list[int]:
    """One plan through the official loop: one entry a frame, an accumulated clock."""
    entries = sorted(((float(t), s) for s, t in enumerate(row) if not np.isnan(t)), key=lambda entry: entry[0])
    steps = [-1] * len(row)
    taken, frame, clock = 0, 0, 0
    while clock < 15:
        if taken < len(entries) and clock >= entries[taken][0]:
            time, column = entries[taken]
            if time != 0:
                steps[column] = frame
            taken += 1
        clock += 1 / fps
        frame += 1
    return steps


def in_advance_driver(row: Floats, fps: int = 10) -> list[int]:
    """One plan through the official environment's loop over the 150 instants, comparing in the plan's own type."""
    rounded = np.round(row, 1)
    steps = [-1] * len(row)
    for frame, instant in enumerate(np.round(np.arange(0, 15.0, 0.1), 1)):
        if instant > 0 and row.dtype.type(instant) in rounded:
            steps[np.argwhere(rounded == row.dtype.type(instant))[0][0]] = frame * (fps // 10)
    return steps


def plans(dtype: type[np.floating[Any]], width: Literal[32, 64] = 64) -> st.SearchStrategy[Floats]:
    tenths = st.integers(0, 152).map(lambda k: k / 10)
    halves = st.integers(0, 302).map(lambda k: k / 20)  # on the edge of rounding
    anything = st.floats(0, 16, width=width)
    value = st.one_of(tenths, halves, anything, st.just(float("nan")))
    return hnp.arrays(dtype, st.tuples(st.integers(1, 3), st.integers(1, 6)), elements=value.map(dtype))


@settings(max_examples=300)
@given(plans(np.float64), st.sampled_from([60, 10, 30, 7, 1]))
def test_simulate_rule_equals_the_driver(times: Floats, fps: int) -> None:
    expected = [simulate_driver(row, fps) for row in times]
    np.testing.assert_array_equal(plan_to_steps(times, fps, "simulate"), expected)


@settings(max_examples=300)
@given(plans(np.float32, 32), st.sampled_from([60, 10]))
def test_simulate_rule_takes_float32_at_its_exact_value(times: Floats, fps: int) -> None:
    expected = [simulate_driver(row, fps) for row in times]
    np.testing.assert_array_equal(plan_to_steps(times, fps, "simulate"), expected)


@settings(max_examples=200)
@given(st.one_of(plans(np.float32, 32), plans(np.float64)), st.sampled_from([10, 60]))
def test_in_advance_rule_equals_the_environment(times: Floats, fps: int) -> None:
    expected = [in_advance_driver(row, fps) for row in times]
    np.testing.assert_array_equal(plan_to_steps(times, fps, "in_advance"), expected)


@pytest.mark.parametrize(("fps", "frames"), [(60, 900), (10, 151)])
def test_frames_of_the_official_loop(fps: int, frames: int) -> None:
    assert len(official_clock(fps)) == frames


def test_a_tenth_at_60_fps_fires_before_step_7() -> None:
    np.testing.assert_array_equal(plan_to_steps([[0.1]], 60, "simulate"), [[7]])


def test_one_entry_a_frame_and_zero_uses_its_frame() -> None:
    # Two zeros take frames 0 and 1, so the entry due in frame 1 waits for frame 2.
    np.testing.assert_array_equal(plan_to_steps([[0.0, 0.1, 0.0]], 10, "simulate"), [[-1, 2, -1]])
    # Equal times go in column order, one a frame.
    np.testing.assert_array_equal(plan_to_steps([[1.0, 1.0, 0.5]], 10, "simulate")[0, :2], [10 + 1, 11 + 1])


def test_no_entry_uses_no_frame() -> None:
    nan = float("nan")
    np.testing.assert_array_equal(plan_to_steps([[nan, 0.1, nan]], 10, "simulate"), [[-1, 1, -1]])


def test_end_of_the_simulate_loop() -> None:
    # The frame 150 of the 151 at 10 fps exists; 15 s and later is never reached.
    clock = official_clock(10)
    times = [[clock[-1], 15.0, 3e38]]
    np.testing.assert_array_equal(plan_to_steps(times, 10, "simulate"), [[150, -1, -1]])


def test_a_time_beyond_all_bounds_is_never() -> None:
    for dtype in (np.float32, np.float64):
        times = np.array([[np.finfo(dtype).max, 16.0, 15.05]], dtype)
        np.testing.assert_array_equal(plan_to_steps(times, 10, "in_advance"), [[-1, -1, -1]])
        np.testing.assert_array_equal(plan_to_steps(times, 60, "simulate"), [[-1, -1, -1]])


def test_in_advance_zero_end_and_ties() -> None:
    times = np.array([[0.04, 14.9, 15.0, 2.0, 2.04, 0.05]])
    np.testing.assert_array_equal(plan_to_steps(times, 10, "in_advance"), [[-1, 149, -1, 20, -1, -1]])
    np.testing.assert_array_equal(plan_to_steps(times, 60, "in_advance"), [[-1, 894, -1, 120, -1, -1]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_slot_of_the_official_action_is_reached(dtype: type[np.floating[Any]]) -> None:
    """All 149 instants can be chosen by an action a = k / 150, in either type."""
    action = (np.arange(151) / 150).astype(dtype)[:, None]
    steps = plan_to_steps(action * dtype(15), 10, "in_advance")[:, 0]
    np.testing.assert_array_equal(steps, [-1, *range(1, 150), -1])


def test_rounding_is_half_to_even_in_the_type_of_the_input() -> None:
    # 0.25 * 10 = 2.5 -> 2 and 0.75 * 10 = 7.5 -> 8 in both types; 0.35 is not a tie in float64
    # as a number, but 0.35 * 10 is 3.5 exactly, and becomes 4.
    for dtype in (np.float32, np.float64):
        times = np.array([[0.25, 0.75, 0.35]], dtype)
        np.testing.assert_array_equal(plan_to_steps(times, 10, "in_advance"), [[2, 8, 4]])


def test_shapes_and_types() -> None:
    assert plan_to_steps(np.empty((0, 6)), 10, "in_advance").shape == (0, 6)
    assert plan_to_steps(np.empty((2, 0)), 60, "simulate").shape == (2, 0)
    steps = plan_to_steps([[1, 2]], 10, "simulate")
    assert steps.dtype == np.int64
    np.testing.assert_array_equal(steps, plan_to_steps([[1.0, 2.0]], 10, "simulate"))


BAD: dict[str, tuple[tuple[Any, Any, Any], str]] = {
    "one row": ((np.zeros(3), 10, "simulate"), "times: expected shape"),
    "three axes": ((np.zeros((1, 2, 3)), 10, "simulate"), "times: expected shape"),
    "unequal rows": (([[1.0], [1.0, 2.0]], 10, "simulate"), "times: expected a rectangular"),
    "text": (([["soon"]], 10, "simulate"), "times: expected float32 or float64"),
    "flags": ((np.ones((1, 2), bool), 10, "simulate"), "times: expected float32 or float64"),
    "complex": ((np.ones((1, 2), complex), 10, "simulate"), "times: expected float32 or float64"),
    "half precision": ((np.ones((1, 2), np.float16), 10, "simulate"), "times: expected float32 or float64"),
    "objects": (([[None, 1.0]], 10, "simulate"), "times: expected float32 or float64"),
    "negative": (([[0.0, -0.5]], 10, "simulate"), "times: expected no negative time, got -0.5 in row 0, column 1"),
    "infinite": (([[np.inf]], 10, "in_advance"), "times: expected finite"),
    "minus infinite": (([[-np.inf]], 10, "in_advance"), "times: expected finite"),
    "fps zero": (([[1.0]], 0, "simulate"), "fps: expected a positive whole number"),
    "fps negative": (([[1.0]], -10, "simulate"), "fps: expected a positive whole number"),
    "fps not whole": (([[1.0]], 59.94, "simulate"), "fps: expected a positive whole number"),
    "fps infinite": (([[1.0]], np.inf, "simulate"), "fps: expected a positive whole number"),
    "fps nan": (([[1.0]], np.nan, "simulate"), "fps: expected a positive whole number"),
    "fps text": (([[1.0]], "60", "simulate"), "fps: expected a positive whole number"),
    "fps flag": (([[1.0]], True, "simulate"), "fps: expected a positive whole number"),
    "fps not of tenths": (([[1.0]], 25, "in_advance"), "fps: expected a multiple of 10"),
    "unknown rule": (([[1.0]], 10, "on_the_fly"), "rule: expected one of simulate, in_advance"),
    "rule none": (([[1.0]], 10, None), "rule: expected one of simulate, in_advance"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_plans_get_one_line(case: str) -> None:
    arguments, message = BAD[case]
    with pytest.raises(ValueError, match=message) as caught:
        plan_to_steps(*arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fps", [1, 10, 25, 60, 240])
def test_steps_have_times_that_give_them_again(fps: int) -> None:
    """Step 0, which the rule never gives, becomes step 1."""
    steps = np.stack([np.arange(1, 15 * fps), np.full(15 * fps - 1, -1)], axis=1)
    times = steps_to_times(steps, fps)
    assert np.isnan(times[:, 1]).all()
    np.testing.assert_array_equal(plan_to_steps(times, fps, "simulate"), steps)
    assert steps_to_times(np.array([0]), fps) == times[0, 0]

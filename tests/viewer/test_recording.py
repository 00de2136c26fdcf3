"""Recordings hold what `simulate` computes, frame by frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from iphyre_jax import Scene, load_scene, simulate
from iphyre_jax.execution import configuration
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.viewer.recording import NotCompiledError, Recording, record

HOLE = load_scene("hole")
SOLVES = [-1, -1, 83, 32]


@pytest.fixture(scope="module")
def solved() -> Recording:
    return record(HOLE, SOLVES)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_a_recording_is_what_simulate_plays(dtype: str) -> None:
    plans = [SOLVES, [-1, -1, -1, 32], [40, 80, 120, 160], [-1, -1, -1, -1]]
    played = simulate(HOLE, plans, fps=60, dtype=dtype, sample_every=20)
    assert played.samples is not None
    moving = np.flatnonzero(HOLE.dynamic)
    for k, plan in enumerate(plans):
        one = record(HOLE, plan, dtype=dtype)
        assert (one.success, one.steps, one.eliminations) == (
            played.success[k],
            played.steps[k],
            played.eliminations[k],
        )
        if dtype == "float64":  # to the last bit
            assert one.reward == played.reward[k]
            kept = one.poses[::20][:, moving]
            np.testing.assert_array_equal(kept, played.samples[k, : len(kept)][:, moving])


def test_frames_begin_at_the_scene_and_end_with_success(solved: Recording) -> None:
    assert solved.success
    assert len(solved.poses) == len(solved.velocities) == len(solved.contacts) == solved.steps + 1
    np.testing.assert_array_equal(solved.poses[0, 6:, :2], HOLE.balls[:, :2])
    assert solved.poses[-2, 6, 1] <= 600 < solved.poses[-1, 6, 1]


def test_velocities_are_those_that_move_the_ball(solved: Recording) -> None:
    """In free fall there is no contact and no bias: a step moves the ball by the velocity of the frame before."""
    free = np.isnan(solved.contacts[:, :, 0]).all(axis=1)
    falling = np.flatnonzero(free[:-2] & free[1:-1] & free[2:])
    assert len(falling) > 50
    moved = (solved.poses[falling + 1, 6, :2] - solved.poses[falling, 6, :2]) * 60
    np.testing.assert_allclose(moved, solved.velocities[falling, 6], atol=1e-9)


def test_contacts_lie_on_the_border_of_the_ball(solved: Recording) -> None:
    frames, slots = np.nonzero(np.isfinite(solved.contacts[:, :, 0]))
    assert len(frames) > 20
    apart = np.hypot(*(solved.contacts[frames, slots] - solved.poses[frames, 6, :2]).T)
    np.testing.assert_allclose(apart, HOLE.balls[0, 2], atol=1e-6)


def test_blocks_are_gone_after_the_frame_of_their_step(solved: Recording) -> None:
    assert solved.last_frames.tolist() == [261, 261, 261, 261, 83, 32, 261]


def test_poses_from_elsewhere_make_a_recording() -> None:
    played = simulate(HOLE, [SOLVES], fps=60, dtype="float64", sample_every=1)
    assert played.samples is not None
    steps = int(played.steps[0])
    own = Recording.of_poses(HOLE, SOLVES, played.samples[0, : steps + 1], success=bool(played.success[0]))
    assert own.reward == played.reward[0]
    assert own.eliminations == 2
    assert np.isfinite(own.poses).all()
    np.testing.assert_array_equal(own.poses[:, 6], record(HOLE, SOLVES).poses[:, 6])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"plan": [1] * 5}, "plan: expected at most 4 integers"),
        ({"plan": [0.5]}, "plan: expected at most 4 integers, got float64"),
        ({"plan": [-2]}, "plan: expected step indices or -1"),
        ({"plan": [], "fps": 0}, "fps: expected"),
        ({"plan": [], "dtype": "float16"}, "dtype: expected"),
        ({"plan": [], "resets": 0}, "resets: expected"),
        ({"plan": [], "fps": 100_000_000}, "at most 100000, got 100000000"),
    ],
)
def test_a_wrong_argument_gets_one_line(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError) as error:
        record(HOLE, **arguments)  # type: ignore[arg-type]
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_play_that_needs_more_contacts_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball among six bars: twice the slots of its topology, as `simulate` gives it."""
    monkeypatch.setattr(configuration, "cache_folder", lambda: tmp_path)  # the tests' has it from an earlier run
    turns = 2 * np.pi * np.arange(6) / 6 + 0.3
    ends = 300 + np.array([26, 90])[None, :, None] * np.stack([np.cos(turns), np.sin(turns)], axis=-1)[:, None]
    crowded = Scene(
        name="crowded",
        blocks=ends,
        balls=[[300, 300, 20]],
        eliminable=[False] * 7,
        dynamic=[False] * 6 + [True],
    )
    with pytest.raises(NotCompiledError):
        record(crowded, [], fps=10, may_compile=False)
    made, played = record(crowded, [], fps=10), simulate(crowded, [[]], fps=10, dtype="float64")
    assert record(crowded, [], fps=10, may_compile=False).steps == made.steps
    assert (made.fault, made.steps, made.reward) == (0, int(played.steps[0]), float(played.reward[0]))
    assert made.contacts.shape[1] > topology_of(crowded).slots


def test_both_engines_side_by_side() -> None:
    from parity.reports.film import play_both

    ours, theirs = play_both(HOLE, SOLVES, 60, "float64", 1)
    assert (ours.success, ours.steps, ours.reward) == (theirs.success, theirs.steps, theirs.reward)
    np.testing.assert_allclose(ours.poses, theirs.poses, atol=1e-6)

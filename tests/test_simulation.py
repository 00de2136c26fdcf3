"""What `simulate` and `simulate_many` mean: times, columns, samples, accounting, order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
import pytest

from iphyre_jax import Scene, load_scene, simulate, simulate_many
from iphyre_jax.execution.devices import LANES
from iphyre_jax.scenes.files import write_scene

GRAVITY = 100.0  # px/s^2


def falling(y: float = 150.0, *, columns: int = 2, name: str = "made for a test") -> Scene:
    """Return a ball over short bars, none of which it touches; its column is free down to the goal."""
    bars = [[[10.0 + 90 * k, 300.0], [60.0 + 90 * k, 300.0]] for k in range(columns)]
    flags = [False] * columns + [True]
    return Scene(name, bars, [[580.0, y, 10.0]], [not flag for flag in flags], flags)


def step_below_goal(y: float, fps: float) -> int:
    """Return the step after which a ball that falls freely from y is below the goal line."""
    k = 0
    while y + GRAVITY / fps**2 * k * (k - 1) / 2 <= 600:
        k += 1
    return k


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("fps", [10, 60, 24.5])
def test_the_solving_step_is_counted_and_ends_the_play(dtype: str, fps: float) -> None:
    played = simulate(falling(), [[-1, -1]], fps=fps, duration=10, dtype=dtype, sample_every=1)
    made = step_below_goal(150, fps)
    assert played.success.tolist() == [True]
    assert played.steps.tolist() == [made]
    assert played.fault.tolist() == [0]
    np.testing.assert_allclose(played.reward, [1000 - made / fps], rtol=0, atol=1e-9)
    assert played.samples is not None
    assert played.samples.shape == (1, int(10 * fps) + 1, 3, 3)
    assert played.samples[0, made - 1, 2, 1] <= 600 < played.samples[0, made, 2, 1]
    after = played.samples[0, made:]
    np.testing.assert_array_equal(after, np.broadcast_to(after[0], after.shape))


def test_all_balls_must_be_below_at_once() -> None:
    """One ball is held by a bar: below the goal the other one flies on, and the play makes all its steps."""
    scene = Scene(
        "two balls",
        [[[50, 300], [250, 300]]],
        [[150, 270, 20], [400, 200, 20]],
        [True, False, False],
        [False, True, True],
    )
    played = simulate(scene, [[-1], [30]], fps=10, dtype="float64", sample_every=150)
    assert played.success.tolist() == [False, True]
    assert played.steps[0] == 150
    assert played.eliminations.tolist() == [0, 1]
    assert played.samples is not None
    assert played.samples[0, 1, 2, 1] > 5000


def test_a_block_goes_before_the_step_of_its_index() -> None:
    """Removed before step k, the bar carries the ball for the last time in step k - 1, so in the sample after k steps
    the ball has not moved yet and in that after k + 2 it has, by one step of gravity."""
    scene = Scene("on a bar", [[[100, 400], [500, 400]]], [[300, 370, 20]], [True, False], [False, True])
    fps = 60
    still = simulate(scene, [[-1]], fps=fps, duration=3, dtype="float64", sample_every=1).samples
    assert still is not None
    for k in (0, 1, 90):
        played = simulate(scene, [[k]], fps=fps, duration=3, dtype="float64", sample_every=1).samples
        assert played is not None
        np.testing.assert_array_equal(played[0, : k + 1], still[0, : k + 1])
        speed_before = (still[0, k + 1, 1, 1] - still[0, k, 1, 1]) * fps
        fall = played[0, k + 2, 1, 1] - played[0, k + 1, 1, 1]
        np.testing.assert_allclose(fall, (speed_before + GRAVITY / fps) / fps, atol=2e-3)
        assert fall > 0.02
        assert not np.isnan(played[0, k]).any()
        assert np.isnan(played[0, k + 1 :, 0]).all()
        assert not np.isnan(played[0, :, 1]).any()


def test_accounting_of_removals() -> None:
    """Removals after the end do not count; never, missing and far columns neither."""
    fps = 10
    made = step_below_goal(150, fps)
    plan = [
        [0, 0, 0],
        [-1, -1, -1],
        [made - 1, 3, -1],
        [made, 3, made - 1],
        [10**6, 2**40, 0],
        [5, -1, 5],
    ]
    played = simulate(falling(columns=3), plan, fps=fps)
    assert played.eliminations.tolist() == [3, 0, 2, 2, 1, 2]
    np.testing.assert_array_equal(played.steps, made)
    np.testing.assert_allclose(played.reward, 1000 - 10 * played.eliminations - made / fps, rtol=0, atol=1e-9)


def test_an_unsolved_play_is_charged_for_its_time() -> None:
    played = simulate("hole", [[-1, -1, -1, -1], [3, -1, -1, -1]], fps=60)
    assert played.success.tolist() == [False, False]
    np.testing.assert_array_equal(played.steps, 900)
    np.testing.assert_allclose(played.reward, [-15, -25])


def test_missing_columns_mean_never_and_columns_of_never_may_be_too_many() -> None:
    whole = simulate("hole", [[30, 60, -1, -1]], fps=10, sample_every=50)
    for plan in ([[30, 60]], [[30, 60, -1]], [[30, 60, -1, -1, -1, -1, -1]]):
        other = simulate("hole", plan, fps=10, sample_every=50)
        np.testing.assert_array_equal(other.samples, whole.samples)
        np.testing.assert_array_equal(other.eliminations, [2])
    never = simulate("hole", np.zeros((3, 0), int), fps=10)
    np.testing.assert_array_equal(never.eliminations, [0, 0, 0])


@pytest.mark.parametrize("kind", [list, np.int8, np.uint8, np.int64, np.uint64])
def test_plans_of_any_integers(kind: Any) -> None:
    plan = [[30, 60], [0, 5]]
    given = plan if kind is list else np.array(plan, kind)
    played = simulate("hole", given, fps=10)
    np.testing.assert_array_equal(played.steps, simulate("hole", plan, fps=10).steps)
    assert played.eliminations.tolist() == [2, 2]


def test_types_and_shapes_of_the_result() -> None:
    played = simulate("hole", [[30, 60]] * 3, fps=10, duration=2.0)
    kinds = {"success": bool, "steps": np.int64, "eliminations": np.int64, "reward": np.float64, "fault": np.int64}
    for name, kind in kinds.items():
        field = getattr(played, name)
        assert type(field) is np.ndarray
        assert field.shape == (3,)
        assert field.dtype == kind
    assert played.samples is None
    with pytest.raises(AttributeError):
        played.steps = played.fault  # type: ignore[misc]


@pytest.mark.parametrize("every", [1, 7, 20, 21])
def test_samples_are_every_so_many_steps(every: int) -> None:
    """K = duration x fps // sample_every + 1, whether it divides or not; sampling changes nothing else."""
    plan = [[3, 11, -1, 0], [-1, -1, -1, -1]]
    options = {"fps": 10, "duration": 2.0, "dtype": "float64"}
    full = simulate("hole", plan, sample_every=1, **options)
    some = simulate("hole", plan, sample_every=every, **options)
    none = simulate("hole", plan, **options)
    assert full.samples is not None
    assert some.samples is not None
    assert some.samples.shape == (2, 20 // every + 1, 7, 3)
    np.testing.assert_array_equal(some.samples, full.samples[:, ::every])
    for name in ("success", "steps", "eliminations", "reward", "fault"):
        np.testing.assert_array_equal(getattr(some, name), getattr(none, name))


def test_samples_of_blocks() -> None:
    """Centre and angle 0 of what rests; seen after k steps if removed before step k, NaN from the next sample."""
    scene = load_scene("hole")
    first, second = scene.eliminable_blocks[:2]
    samples = simulate(scene, [[4, 10, -1, -1]], fps=10, duration=3, sample_every=2).samples
    assert samples is not None
    start = np.zeros((scene.n_objects, 3))
    start[: scene.n_blocks, :2] = scene.blocks.mean(axis=1)
    start[scene.n_blocks :, :2] = scene.balls[:, :2]
    np.testing.assert_array_equal(samples[0, 0], start.astype(np.float32))
    there = ~np.isnan(samples[0]).any(axis=-1)
    for block, last in ((first, 2), (second, 5)):
        np.testing.assert_array_equal(there[:, block], np.arange(16) <= last)
    others = [i for i in range(scene.n_objects) if i not in (first, second)]
    assert there[:, others].all()


def test_a_removal_after_the_end_leaves_the_last_pose() -> None:
    made = step_below_goal(150, 10)
    samples = simulate(falling(), [[made + 1, made - 1]], fps=10, sample_every=1).samples
    assert samples is not None
    assert not np.isnan(samples[0, :, 0]).any()
    np.testing.assert_array_equal(np.isnan(samples[0, :, 1, 0]), np.arange(151) >= made)


@pytest.mark.parametrize("count", [0, 1, LANES - 1, LANES, LANES + 1, 2 * LANES + 3])
def test_any_number_of_plans(count: int) -> None:
    generator = np.random.default_rng(count)
    plan = generator.integers(-1, 60, (count, 4))
    played = simulate("hole", plan, fps=10, duration=6, sample_every=60)
    assert played.samples is not None
    assert played.samples.shape == (count, 2, 7, 3)
    assert all(len(getattr(played, name)) == count for name in ("success", "steps", "eliminations", "reward", "fault"))
    if count:
        last = simulate("hole", plan[-1:], fps=10, duration=6, sample_every=60)
        np.testing.assert_array_equal(played.samples[-1:], last.samples)
    nothing = simulate_many(["hole"], np.zeros(0, int), np.zeros((0, 4), int), fps=10)
    assert nothing.steps.shape == (0,)


def test_a_scene_file_plays_as_the_scene(tmp_path: Path) -> None:
    scene = falling(y=200)
    path = tmp_path / "falling.json"
    write_scene(scene, path)
    expected = simulate(scene, [[3, -1]], fps=10)
    for given in (path, str(path)):
        played = simulate(given, [[3, -1]], fps=10)
        np.testing.assert_array_equal(played.reward, expected.reward)
    both = simulate_many([path, scene], [1, 0], [[3, -1]] * 2, fps=10)
    np.testing.assert_array_equal(both.reward, np.repeat(expected.reward, 2))


def drawn(scene: Scene, count: int, seed: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng(seed).integers(-1, 70, (count, len(scene.eliminable_blocks)))


@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.further), "float32"])
def test_many_equals_one_by_one_in_the_callers_order(dtype: str) -> None:
    """Four scenes of two topologies, interleaved, one of them listed twice and one never asked for."""
    scenes = [load_scene(name) for name in ("hole", "fill", "support", "hole", "angle", "direction")]
    generator = np.random.default_rng(0)
    which = generator.choice([0, 1, 2, 3, 4], 160)
    plan = np.full((160, 6), -1)
    for row, k in enumerate(which):
        plan[row, : len(scenes[k].eliminable_blocks)] = drawn(scenes[k], 1, row)[0]
    many = simulate_many(scenes, which, plan, fps=10, dtype=dtype, sample_every=30)
    assert many.samples is not None
    assert many.samples.shape == (160, 6, max(scene.n_objects for scene in scenes), 3)
    for k in range(len(scenes)):
        mine = which == k
        alone = simulate(scenes[k], plan[mine], fps=10, dtype=dtype, sample_every=30)
        assert alone.samples is not None
        np.testing.assert_array_equal(many.samples[mine, :, : scenes[k].n_objects], alone.samples)
        assert np.isnan(many.samples[mine, :, scenes[k].n_objects :]).all()
        for name in ("success", "steps", "eliminations", "reward", "fault"):
            np.testing.assert_array_equal(getattr(many, name)[mine], getattr(alone, name))
    assert 0 < many.success.sum() < 160


@pytest.mark.parametrize("dtype", [pytest.param("float64", marks=pytest.mark.further), "float32"])
def test_plans_that_share_their_beginnings_end_as_they_do_alone(dtype: str) -> None:
    """Two layouts, twins, plans that never remove, play that ends early; to the bit of every count."""
    generator = np.random.default_rng(0)
    plan = generator.integers(-1, 12, (300, 4)) * 10
    plan[plan < 0] = -1
    which = generator.integers(0, 2, 300)
    plan[:40], which[:40] = plan[40:80], which[40:80]
    plan[which == 1, 2:] = -1  # spring has two blocks
    alone, shared = (
        simulate_many(["hole", "spring"], which, plan, fps=10, dtype=dtype, share_prefixes=share)
        for share in (False, True)
    )
    for name in ("success", "steps", "eliminations", "reward", "fault"):
        np.testing.assert_array_equal(getattr(shared, name), getattr(alone, name))
    assert alone.success.any()
    assert not alone.success.all()
    nothing = simulate_many(["hole"], np.zeros(0, int), np.zeros((0, 4), int), fps=10, share_prefixes=True)
    assert nothing.steps.shape == (0,)


def test_shared_beginnings_have_no_samples() -> None:
    with pytest.raises(ValueError, match=r"^share_prefixes: expected no samples"):
        simulate_many(["hole"], [0], [[-1]], sample_every=3, share_prefixes=True)
    with pytest.raises(ValueError, match=r"^share_prefixes: expected True or False, got 1$"):
        simulate_many(["hole"], [0], [[-1]], share_prefixes=1)  # type: ignore[arg-type]


def test_steps_beyond_int64_are_never_reached() -> None:
    """They wrapped around, 2**64 - 1 to -1 and 2**64 - 2 to a number that was refused."""
    never = simulate("hole", np.array([[2**64 - 2, 2**64 - 1]], np.uint64), fps=10, duration=1.0)
    assert never.eliminations.tolist() == [0]
    with pytest.raises(ValueError, match="row 0 removes block 4, but its scene has 4"):
        simulate("hole", np.array([[0, 0, 0, 0, 2**64 - 1]], np.uint64), fps=10, duration=1.0)


@pytest.mark.parametrize(
    ("plan", "hint"),
    [
        ([[0.5, 1.5]], "iphyre_jax.plan_to_steps turns seconds into steps"),
        ([3, 5], r"one plan is a batch of one, \[plan\]"),
        (None, ""),
        ([], r"float64 of shape \(0,\)"),
    ],
)
def test_a_plan_of_another_form_is_told_what_to_do(plan: Any, hint: str) -> None:
    with pytest.raises(ValueError, match=rf"^eliminate_at: expected integers of shape \(B, S\), got [^\n]*{hint}$"):
        simulate("hole", plan)


def test_scenes_without_an_order_are_refused() -> None:
    """The numbers of `which` would mean other scenes in each process, as the order of a set does."""
    with pytest.raises(ValueError, match=r"^scenes: expected a sequence of names, files or Scenes, got a set of 2$"):
        simulate_many({"hole", "support"}, [0, 1], [[18, 6], [18, 6]])
    with pytest.raises(
        ValueError, match=r"^which: expected integers, the scene of each plan, got float64 of shape \(1,\)$"
    ):
        simulate_many(["hole"], [0.0], [[1, 2]])


def test_inside_jit_the_message_names_rollout() -> None:
    with pytest.raises(ValueError, match=r"^eliminate_at: [^\n]*inside jax\.jit call iphyre_jax\.rollout(\n|$)"):
        jax.jit(lambda plan: simulate("hole", plan).steps)(np.zeros((1, 2), np.int32))

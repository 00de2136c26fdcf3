"""Free bodies, collisions between them, and bars: laws that hold whatever the scene."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.physics.worlds import GRAVITY, LAW_DTYPES, Bench, make_scene, watch

BAR_MOMENT = 200 / 3  # px^2, of every moving bar, whatever its length
RESTITUTION = 0.01
BIAS_BASE = np.float64(np.float32(0.9)) ** 60  # overlap left after a second
SLOP = float(np.float32(0.1))

both = pytest.mark.parametrize("dtype", LAW_DTYPES)


def fallen(steps: np.ndarray | int, fps: float) -> np.ndarray:
    """Positions move before velocities, so step k adds (k - 1) g / fps^2."""
    steps = np.asarray(steps, np.float64)
    return GRAVITY / fps**2 * steps * (steps - 1) / 2


@both
@pytest.mark.parametrize("fps", [10, 60, 144])
def test_free_fall_follows_its_discrete_formula(dtype: str, fps: int) -> None:
    played, poses = watch(make_scene([(300.0, -500.0, 20.0)]), dtype, fps=fps, duration=6.0)
    y = -500 + fallen(np.arange(len(poses)), fps)
    made = int(np.argmax(y > 600))
    assert played.success[0]
    assert played.steps[0] == made
    y[made:] = y[made]
    np.testing.assert_allclose(poses[:, 0, 1], y, rtol=0, atol=1e-9 if dtype == "float64" else 0.02)
    np.testing.assert_array_equal(poses[:, 0, 0], 300)
    np.testing.assert_array_equal(poses[:, 0, 2], 0)


@pytest.mark.slow
@both
def test_a_free_bar_turns_evenly_and_its_centre_falls_like_a_ball(dtype: str) -> None:
    bench = Bench(
        make_scene([(5000.0, 0.0, 20.0)], moving=[(100, 100, 250, 130)]),
        dtype,
        velocity=[[30, -40], [0, 0]],
        angular_velocity=[2.5, -1.5],
    )
    steps = 120
    bench.step(steps)
    exact = {"rtol": 1e-12 if dtype == "float64" else 2e-5}
    np.testing.assert_allclose(bench.angle, [2.5 * steps / 60, -1.5 * steps / 60], **exact)
    np.testing.assert_array_equal(bench.angular_velocity, [2.5, -1.5])
    start = np.array([[175.0, 115.0], [5000.0, 0.0]])
    flown = np.array([[30.0, -40.0], [0.0, 0.0]]) * steps / 60
    flown[:, 1] += fallen(steps, 60)
    np.testing.assert_allclose(bench.position, start + flown, **exact)


@pytest.mark.slow
@both
@pytest.mark.parametrize("fps", [10, 60])
def test_tied_and_colliding_bodies_fall_as_one(dtype: str, fps: int) -> None:
    """No force from within moves the centre of mass: not a pin, a spring nor contacts of balls and a bar."""
    bodies = make_scene(
        [(330.0, -3000.0, 15.0), (390.0, -2960.0, 18.0)],
        moving=[(240.0, -3010.0, 300.0, -2950.0)],
        joints=[(0, 1)],
        springs=[(1, 2)],
    )
    _, poses = watch(bodies, dtype, fps=fps, duration=8.0)
    turned = np.ptp(poses[:, :, 2], axis=0)
    apart = np.hypot(*(poses[:, 1, :2] - poses[:, 2, :2]).T)
    assert apart.min() < 33  # the balls met
    assert turned.max() > 0.1  # friction turned something
    centre = poses[:, :, :2].mean(axis=1)
    exact = {"rtol": 0, "atol": 1e-8 if dtype == "float64" else 0.05}
    np.testing.assert_allclose(centre[:, 0], centre[0, 0], **exact)
    np.testing.assert_allclose(centre[:, 1], centre[0, 1] + fallen(np.arange(len(poses)), fps), **exact)


@both
def test_two_balls_share_momentum_by_the_restitution(dtype: str) -> None:
    """Head on at 90 px/s: they part at a hundredth of it, and the sum is kept."""
    pair = make_scene([(100.0, -500.0, 10.0), (150.0, -500.0, 20.0)])
    bench = Bench(pair, dtype, velocity=[[90, 0], [0, 0]])
    bench.step(30)
    exact = {"rtol": 1e-10 if dtype == "float64" else 1e-4}
    wanted = [90 * (1 - RESTITUTION) / 2, 90 * (1 + RESTITUTION) / 2]
    np.testing.assert_allclose(bench.velocity[:, 0], wanted, **exact)
    np.testing.assert_allclose(bench.velocity[:, 1], GRAVITY * 30 / 60, **exact)
    np.testing.assert_allclose(bench.angular_velocity, 0, atol=1e-3 if dtype == "float32" else 1e-9)


@both
def test_a_glancing_blow_turns_balls_by_friction(dtype: str) -> None:
    """The tangent impulse is limited by a quarter of the normal one, and each ball turns by r J / (r^2 / 2)."""
    pair = make_scene([(100.0, -500.0, 10.0), (150.0, -485.0, 20.0)])
    speed = np.array([[150.0, 0], [0, 0]])
    bench = Bench(pair, dtype, velocity=speed)
    while not bench.angular_velocity.any():
        before = bench.velocity
        bench.step()
    change = bench.velocity - before - [0, GRAVITY / 60]
    centres = bench.position
    normal = centres[1] - centres[0]
    normal /= np.hypot(*normal)
    tangent = np.array([-normal[1], normal[0]])
    exact = {"rtol": 1e-9 if dtype == "float64" else 1e-3}
    np.testing.assert_allclose(change[0], -change[1], **exact)
    push, rub = change[1] @ normal, change[1] @ tangent
    assert push > 0
    assert abs(rub) <= 0.25 * push * (1 + exact["rtol"])
    # on_first x (-J) and (-on_second) x J have one sign: friction turns both balls the same way.
    np.testing.assert_allclose(bench.angular_velocity, [-10 * rub / (10**2 / 2), -20 * rub / (20**2 / 2)], **exact)


@both
@pytest.mark.parametrize("length", [60.0, 140.0])
def test_a_bar_hit_off_its_centre_turns_by_its_moment(dtype: str, length: float) -> None:
    """I dw = arm x m dv with I = 200/3 for bars of any length."""
    bar = (300 - length / 2, -500.0, 300 + length / 2, -500.0)
    scene = make_scene([(322.0, -540.0, 15.0)], moving=[bar])
    bench = Bench(scene, dtype, velocity=[[0, 0], [0, 120.0]])
    while not bench.angular_velocity.any():
        before = bench.velocity
        bench.step()
    change = bench.velocity - before - [0, GRAVITY / 60]
    arm = np.array([22.0, -10.0])  # on the bar's upper side, below the ball's centre
    exact = {"rtol": 1e-9 if dtype == "float64" else 1e-3}
    np.testing.assert_allclose(change[0], -change[1], atol=1e-9 if dtype == "float64" else 1e-3, **exact)
    turn = (arm[0] * change[0, 1] - arm[1] * change[0, 0]) / BAR_MOMENT
    assert turn > 0.5
    np.testing.assert_allclose(bench.angular_velocity[0], turn, **exact)


@both
@pytest.mark.parametrize("fps", [10, 60])
def test_first_bounce_by_hand(dtype: str, fps: int) -> None:
    """Restitution sees the speed before gravity; what overlaps beyond the slop is pushed out by its share."""
    top, radius, start = 400.0, 20.0, 203.0
    _, poses = watch(make_scene([(300.0, start, radius)], [(100, top, 500, top)]), dtype, fps=fps, duration=3.0)
    ball = poses[:, 1]
    y = start + fallen(np.arange(len(poses)), fps)
    hit = int(np.argmax(y > top - 10 - radius))
    overlap = y[hit] - (top - 10 - radius)
    back = RESTITUTION * GRAVITY / fps * (hit - 1)
    share = 1 - BIAS_BASE ** (1 / fps)
    out = share * max(overlap - SLOP, 0) * fps
    exact = {"rtol": 0, "atol": 1e-9 if dtype == "float64" else 5e-3}
    np.testing.assert_allclose(ball[: hit + 1, 1], y[: hit + 1], **exact)
    np.testing.assert_allclose(ball[hit + 1, 1], y[hit] - (back + out) / fps, **exact)
    np.testing.assert_allclose(ball[hit + 1, 2], 0, atol=1e-6)


@pytest.mark.slow
@both
@pytest.mark.parametrize("fps", [10, 60])
def test_at_rest_a_ball_and_a_bar_stay(dtype: str, fps: int) -> None:
    """For 15 s. The first step's fall goes below the slop and is pushed back; ten sweeps rock the bar by a hair."""
    scene = make_scene([(200.0, 370.0, 20.0)], [(100, 400, 500, 400)], [(350, 380, 450, 380)])
    played, poses = watch(scene, dtype, fps=fps, duration=15.0)
    assert not played.success[0]
    assert played.steps[0] == 15 * fps
    moved = poses - poses[0]
    np.testing.assert_array_equal(moved[:, 0], 0)
    rounding = 1e-9 if dtype == "float64" else 1e-3
    np.testing.assert_allclose(moved[:, 2, [0, 2]], 0, atol=rounding)
    np.testing.assert_allclose(moved[:, 1, [0, 2]], 0, atol=0.05)
    assert moved[:, :, 1].min() > -rounding
    assert moved[:, 2, 1].max() <= max(SLOP, GRAVITY / fps**2) + rounding
    assert moved[:, 1, 1].max() <= SLOP + 2 * GRAVITY / fps**2  # as in the reference, which lets the bar rock at 10 fps
    late = moved[-2 * fps :]
    assert late[:, :, 1].max() < SLOP + rounding
    assert np.ptp(late[:, 2, 1]) <= rounding
    assert np.ptp(late[:, 1], axis=0).max() < 0.01


@both
def test_a_ball_rolls_down_a_gentle_slope_at_two_thirds(dtype: str) -> None:
    """A disc that does not slip: a = g sin(slope) / (1 + 1/2), and it turns by the way over its radius."""
    slope, radius = math.atan2(1, 6), 20.0
    along, off = np.array([math.cos(slope), math.sin(slope)]), np.array([math.sin(slope), -math.cos(slope)])
    start = np.array([60.0, 210.0]) + (10 + radius - SLOP) * off
    scene = make_scene([(*start.tolist(), radius)], [(0, 200, 600, 300)])
    ball = watch(scene, dtype, fps=240, duration=4.0)[1][:, 1]
    way = (ball[:, :2] - start) @ along
    fall = fallen(np.arange(len(ball)), 240) * math.sin(slope) * 2 / 3
    np.testing.assert_allclose(way[240:], fall[240:], rtol=0.01)
    np.testing.assert_allclose(ball[240:, 2] * radius, way[240:], rtol=0.01)
    np.testing.assert_allclose((ball[:, :2] - start) @ off, 0, atol=0.1)


@both
def test_a_ball_slides_on_a_steep_slope_by_the_friction(dtype: str) -> None:
    """At 45 degrees it slips: a = g (sin - mu cos), angular acceleration 2 mu g cos / r, with mu = 1/4."""
    radius, half = 20.0, math.sqrt(0.5)
    start = np.array([100.0, 100.0]) + (10 + radius - SLOP) * np.array([half, -half])
    scene = make_scene([(*start.tolist(), radius)], [(0, 0, 600, 600)])
    ball = watch(scene, dtype, fps=240, duration=2.0)[1][:, 1]
    fall = fallen(np.arange(len(ball)), 240)
    way = (ball[:, :2] - start) @ [half, half]
    np.testing.assert_allclose(way[120:], fall[120:] * half * (1 - 0.25), rtol=0.02)
    np.testing.assert_allclose(ball[120:, 2], fall[120:] * half * 2 * 0.25 / radius, rtol=0.02)

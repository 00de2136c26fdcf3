"""Pin joints and springs against what they are in a textbook, or step by step by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.physics.worlds import GRAVITY, LAW_DTYPES, Bench, make_scene, watch

BIAS_BASE = np.float64(np.float32(0.9)) ** 60  # error left after a second
both = pytest.mark.parametrize("dtype", LAW_DTYPES)

POST = [(290.0, 100.0, 310.0, 100.0)]  # its centre, (300, 100), holds the joint or spring


@pytest.mark.slow
@both
@pytest.mark.parametrize("fps", [10, 60, 240])
def test_a_pin_keeps_its_length_for_15_s(dtype: str, fps: int) -> None:
    """A pendulum let go from the horizontal.

    A step along the tangent strays by v^2 dt^2 / 2L, at most g dt^2; the pin takes back its share of the error.
    """
    error = 1.1 * GRAVITY / fps**2 / (1 - BIAS_BASE ** (1 / fps))
    scene = make_scene([(420.0, 100.0, 15.0)], POST, joints=[(0, 1)])
    _, poses = watch(scene, dtype, fps=fps, duration=15.0)
    length = np.hypot(*(poses[:, 1, :2] - [300, 100]).T)
    np.testing.assert_allclose(length, 120, rtol=0, atol=error)
    assert poses[:, 1, 0].min() < 210  # it swung to the other side


@pytest.mark.slow
@both
def test_a_small_pendulum_keeps_its_period(dtype: str) -> None:
    """T = 2 pi sqrt(L/g) (1 + a^2 / 16) of a point mass: the pin holds the centre and does not turn the ball."""
    swing, pin = 0.1, 100.0
    start = 300 + pin * math.sin(swing), 100 + pin * math.cos(swing)
    _, poses = watch(make_scene([(*start, 15.0)], POST, joints=[(0, 1)]), dtype, fps=240, duration=15.0)
    x = poses[:, 1, 0] - 300
    crossings = np.flatnonzero(np.sign(x[1:]) != np.sign(x[:-1]))
    assert len(crossings) == 5
    period = 2 * math.pi * math.sqrt(pin / GRAVITY) * (1 + swing**2 / 16)
    np.testing.assert_allclose(np.diff(crossings) / 240, period / 2, rtol=0.005)
    np.testing.assert_array_equal(poses[:, 1, 2], 0)


@pytest.mark.slow
@both
def test_a_dumb_bell_turns_evenly_and_keeps_its_angular_momentum(dtype: str) -> None:
    """Two balls on a pin, thrown with a turn of 0.8 rad/s; forces along the line of centres have no moment."""
    scene = make_scene([(300.0, -2000.0, 10.0), (400.0, -2000.0, 10.0)], joints=[(0, 1)])
    bench = Bench(scene, dtype, fps=240, velocity=[[5, -40], [5, 40]])

    def spin() -> float:
        r, v = bench.position, bench.velocity
        r, v = r - r.mean(axis=0), v - v.mean(axis=0)
        return float(np.sum(r[:, 0] * v[:, 1] - r[:, 1] * v[:, 0]))

    before = spin()
    assert before == 4000
    bench.step(480)
    np.testing.assert_allclose(spin(), before, rtol=1e-10 if dtype == "float64" else 1e-3)
    x, y = bench.position[1] - bench.position[0]
    np.testing.assert_allclose(math.hypot(x, y), 100, rtol=0, atol=0.05)
    np.testing.assert_allclose(math.atan2(y, x), 0.8 * 2, rtol=0.005)
    np.testing.assert_allclose(bench.velocity.mean(axis=0), [5, GRAVITY * 2], rtol=1e-5)


@pytest.mark.slow
@both
def test_a_spring_of_two_balls_is_a_damped_oscillator(dtype: str) -> None:
    """u'' = -2 u - 0.6 u' for two unit masses, stiffness 1 and damping 0.3; u is the extension beyond 20 px."""
    fps, start = 240, 6.0
    scene = make_scene([(300.0, -2000.0, 4.0), (320.0 + start, -2000.0, 4.0)], springs=[(0, 1)])
    _, poses = watch(scene, dtype, fps=fps, duration=7.0)
    stretch = poses[:, 1, 0] - poses[:, 0, 0] - 20
    time = np.arange(len(poses)) / fps
    omega = math.sqrt(2 - 0.3**2)
    wave = start * np.exp(-0.3 * time) * (np.cos(omega * time) + 0.3 / omega * np.sin(omega * time))
    np.testing.assert_allclose(stretch, wave, rtol=0, atol=0.03)

    u, speed, wanted = start, 0.0, []
    for _ in time:
        wanted.append(u)
        speed = (speed - 2 * u / fps) * math.exp(-0.3 * 2 / fps)
        u += speed / fps
    wanted = [start, *wanted[:-1]]  # the first step moves nothing: positions come first
    np.testing.assert_allclose(stretch, wanted, rtol=0, atol=1e-9 if dtype == "float64" else 5e-3)
    np.testing.assert_allclose(poses[:, :, 0].mean(axis=1), 310 + start / 2, atol=1e-9 if dtype == "float64" else 5e-3)
    level = poses[:, 0, 1] - poses[:, 1, 1]
    np.testing.assert_array_equal(level, 0)


@both
@pytest.mark.parametrize("fps", [10, 60])
def test_a_ball_hung_on_a_spring_follows_the_recurrence(dtype: str, fps: int) -> None:
    """One end fixed: decay exp(-0.3 dt), after the spring's pull and gravity; it ends 120 px below the post."""
    scene = make_scene([(300.0, 200.0, 15.0)], POST, springs=[(0, 1)])
    _, poses = watch(scene, dtype, fps=fps, duration=15.0)
    y, speed, wanted = 200.0, 0.0, []
    for _ in poses:
        y += speed / fps
        wanted.append(y)
        speed = (speed + (GRAVITY + 20 - (y - 100)) / fps) * math.exp(-0.3 / fps)
    wanted = [200.0, *wanted[:-1]]
    np.testing.assert_allclose(poses[1:, 1, 1], wanted[1:], rtol=0, atol=1e-8 if dtype == "float64" else 5e-3)
    np.testing.assert_array_equal(poses[:, 1, 0], 300)
    assert abs(poses[-1, 1, 1] - 220) < 5
    np.testing.assert_array_equal(poses[:, 1, 2], 0)


@both
def test_a_spring_without_length_pulls_nowhere(dtype: str) -> None:
    """Two bodies in one place have no direction between them: the ball falls until it has one, and nothing is NaN."""
    scene = make_scene([(300.0, 100.0, 15.0)], POST, springs=[(0, 1)])
    _, poses = watch(scene, dtype, fps=60, duration=0.25)
    assert np.isfinite(poses).all()
    np.testing.assert_array_equal(poses[1, 1], poses[0, 1])

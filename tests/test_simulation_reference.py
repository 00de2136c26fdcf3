"""`simulate` against the reference engine: games, made-up scenes, both rates, both numbers of the reset."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from iphyre_jax import Scene, load_scene, simulate
from parity.engines.reference import run

CLOSE = 1e-6  # px and rad, float64


def compare(scene: Scene, plan: npt.NDArray[np.int64], *, fps: int, resets: int = 1, every: int = 1) -> None:
    """Check outcome and accounting of each plan, and its samples while the reference's body is in play."""
    ours = simulate(scene, plan, fps=fps, dtype="float64", sample_every=every, resets=resets)
    assert ours.samples is not None
    assert not ours.fault.any()
    for row, eliminate_at in enumerate(plan):
        theirs = run(scene, eliminate_at, fps=fps, steps=15 * fps, resets=resets, sample_every=every)
        mine = bool(ours.success[row]), int(ours.steps[row]), int(ours.eliminations[row])
        assert mine == (theirs.success, theirs.steps, theirs.eliminations), (scene.name, eliminate_at.tolist())
        reward = 1000 * theirs.success - 10 * theirs.eliminations - theirs.steps / fps
        assert ours.reward[row] == pytest.approx(reward, abs=1e-9)
        there = ~np.isnan(theirs.samples)
        np.testing.assert_array_equal(~np.isnan(ours.samples[row]), there)
        x, y = theirs.samples[..., 0], theirs.samples[..., 1]
        in_play = (y <= 620) & (abs(x - 300) <= 400)  # NaN compares as out of play
        error = abs(ours.samples[row] - theirs.samples)[in_play]
        assert error.max() < CLOSE, (scene.name, eliminate_at.tolist())


def drawn(scene: Scene, count: int, fps: int, seed: int) -> npt.NDArray[np.int64]:
    """Draw plans: steps of the first 5 s, some never, some at the very start, some at once with another."""
    generator = np.random.default_rng(seed)
    plan = generator.integers(0, 5 * fps, (count, len(scene.eliminable_blocks)))
    plan = np.where(generator.random(plan.shape) < 0.3, -1, plan)
    plan = np.where(generator.random(plan.shape) < 0.15, 0, plan)
    plan[1::3] = np.where(plan[1::3] > 0, plan[1::3, :1], plan[1::3])
    return plan


@pytest.mark.parametrize("fps", [60, 10])
@pytest.mark.parametrize("resets", [1, 2])
@pytest.mark.parametrize("game", ["hole", "fill", "pendulum", "spring", "multi_ball_hinder"])
def test_games_agree(game: str, fps: int, resets: int) -> None:
    scene = load_scene(game)
    compare(scene, drawn(scene, 9, fps, seed=fps + resets), fps=fps, resets=resets, every=1 if fps == 10 else 6)


def test_other_rates_agree() -> None:
    scene = load_scene("fill")
    compare(scene, drawn(scene, 3, 30, seed=1), fps=30)


def test_blocks_removed_at_once_go_in_column_order() -> None:
    """A ball on three links: which of the others takes the hole depends on the order in which blocks go."""
    scene = hung()
    compare(scene, np.array([[20, 20, -1, -1], [20, 20, 20, -1], [20, 20, 20, 20], [0, 0, 0, 0]]), fps=10)


def test_a_scene_without_blocks_agrees() -> None:
    balls = [[300.0, -2000.0, 20.0], [310.0, -2050.0, 15.0]]
    scene = Scene("balls only", [], balls, [False] * 2, [True] * 2)
    compare(scene, np.zeros((1, 0), np.int64), fps=10)


def hung() -> Scene:
    """A ball, and a lower one beneath it, on three pins and springs to posts, and one between them."""
    posts = [(150, 60), (450, 60), (300, 20), (120, 330)]
    bars = [[[x - 15, y], [x + 15, y + 4 * k]] for k, (x, y) in enumerate(posts)]
    balls = [[310.0, 150.0, 16.0], [250.0, 280.0, 20.0]]
    flags = [True] * 4 + [False] * 2
    return Scene("hung", bars, balls, flags, [not flag for flag in flags], ((1, 4), (4, 5)), ((0, 4), (2, 4), (3, 5)))


@pytest.mark.parametrize("fps", [60, 10])
def test_constraints_close_the_holes_as_the_reference_does(fps: int) -> None:
    """Five pins and springs in one list: the last takes the hole of a removed one, which reorders the rest."""
    times = [[2, 3, 4, 5], [5, 3, 1, 4], [1, -1, 2, -1], [-1, -1, -1, 1], [3, 1, -1, 2], [-1, 2, -1, -1], [-1] * 4]
    plan = np.array([[t if t < 0 else t * fps for t in row] for row in times])
    compare(hung(), plan, fps=fps)


@pytest.mark.slow
def test_five_moving_bodies_agree() -> None:
    """Three bars and two balls on two tables, of which one goes: the layout of multi_ball_lever.

    Six balls are in the golden files, and six bodies of both kinds in `make parity-random`.
    """
    tables = [[[60.0, 420.0], [330.0, 420.0]], [[350.0, 470.0], [590.0, 440.0]], [[80.0, 200.0], [260.0, 230.0]]]
    bars = [[[100.0, 395.0], [180.0, 395.0]], [[400.0, 380.0], [470.0, 395.0]], [[230.0, 330.0], [230.0, 260.0]]]
    balls = [[130.0, 180.0, 18.0], [290.0, 380.0, 25.0]]
    static, moving = [True] * 3, [False] * 5
    scene = Scene("five movers", tables + bars, balls, static + moving, [not flag for flag in static + moving])
    compare(scene, np.array([[-1, -1, -1], [30, -1, 5], [12, 20, 25]]), fps=10)


def test_a_play_that_needs_more_slots_is_played_again() -> None:
    """A ball in a star of six bars touches all at once; a topology of one ball has slots for four points."""
    angles = np.arange(6) * np.pi / 3
    star = [[[300 + r * np.cos(a), 300 + r * np.sin(a)] for r in (25, 80)] for a in angles]
    alone = [[[50.0, 550.0], [100.0, 550.0]]]
    removable = [True] * 3 + [False] * 5
    scene = Scene("a star", [*star, *alone], [[300.0, 300.0, 20.0]], removable, [False] * 7 + [True])
    compare(scene, np.array([[-1, -1, -1], [3, -1, 7], [0, 5, -1], [-1, 20, 0]]), fps=10)

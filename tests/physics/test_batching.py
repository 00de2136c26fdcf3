"""A world does not depend on its neighbours or on room that it does not use."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
import pytest

from iphyre_jax import Scene, Simulation, load_scene, rollouts, simulate, simulate_many
from iphyre_jax.physics import Topology, World
from iphyre_jax.scenes import compile as builder
from iphyre_jax.scenes.compile import compile_scene, step_timing
from tests.physics.worlds import DTYPES, make_scene

pytestmark = pytest.mark.usefixtures("few_optimisations")  # `test_compiled_steps` has them all

FPS = 10
STEPS = 150
PLAN_COLUMNS = 6  # columns of a plan in lanes

both = pytest.mark.parametrize("dtype", DTYPES)


def plans(game: str, count: int, seed: int = 0) -> npt.NDArray[np.int64]:
    """Draw plans: each block goes before one of the first 60 steps, or never in a quarter of the cases."""
    generator = np.random.default_rng(seed)
    drawn = generator.integers(0, 60, (count, len(load_scene(game).eliminable_blocks)))
    return np.where(generator.random(drawn.shape) < 0.25, -1, drawn)


def assert_same_bits(one: Any, two: Any) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        np.testing.assert_array_equal(a, b)


def rows(played: Simulation, index: Any) -> tuple[npt.NDArray[Any], ...]:
    assert played.samples is not None
    fields = played.success, played.steps, played.eliminations, played.reward, played.fault, played.samples
    return tuple(field[index] for field in fields)


@cache
def compiled(topology: Topology, dtype: str, lanes: tuple[int, ...]) -> Any:
    return jax.jit(partial(rollouts.rollout, topology))


def lay(worlds: list[World]) -> World:
    """Return worlds side by side in lanes."""
    return jax.tree.map(lambda *leaves: np.stack(leaves, -1), *worlds)


def roll(
    topology: Topology, world: World, plan: npt.NDArray[Any], dtype: str, steps: int = STEPS, fps: int = FPS
) -> rollouts.EpisodeResult:
    """Play plans (places, *lanes) and return the outcome as NumPy arrays."""
    with jax.enable_x64(dtype == "float64"):
        play = compiled(topology, dtype, plan.shape[1:])
        played = play(world, step_timing(fps, dtype), plan.astype(np.int32), np.int32(steps))
        return jax.tree.map(np.asarray, played)


def columns(plan: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Turn plans (B, S) into lanes (PLACES, B)."""
    out = np.full((PLAN_COLUMNS, len(plan)), -1)
    out[: plan.shape[1]] = plan.T
    return out


@pytest.mark.parametrize(
    ("game", "dtype"),
    [
        ("hole", "float32"),
        ("fill", "float64"),
        *(pytest.param(*case, marks=pytest.mark.further) for case in (("hole", "float64"), ("fill", "float32"))),
    ],
)
def test_a_world_is_the_same_bits_wherever_it_stands(game: str, dtype: str) -> None:
    """Among 150 worlds, hence in two chunks, in another order, and with no neighbour but empty lanes."""
    plan = plans(game, 150)
    options = {"fps": FPS, "dtype": dtype, "sample_every": 30}
    played = simulate(game, plan, **options)
    order = np.random.default_rng(1).permutation(len(plan))
    assert_same_bits(rows(simulate(game, plan[order], **options), slice(None)), rows(played, order))
    for row in (0, 77, 149):
        assert_same_bits(rows(simulate(game, plan[row : row + 1], **options), 0), rows(played, row))


@pytest.mark.slow
@both
def test_worlds_without_lanes_in_few_lanes_and_in_many_agree(dtype: str) -> None:
    """Compiled apart, so within rounding. Eight seconds at 60 fps of bouncing."""
    scene, fps, steps = load_scene("hole"), 60, 480
    topology, world = compile_scene(scene, dtype=dtype)
    plan = plans("hole", 3, seed=5)
    many = simulate(scene, plan, fps=fps, duration=steps / fps, dtype=dtype, sample_every=steps)
    few = roll(topology, lay([world] * 3), columns(plan), dtype, steps, fps)
    assert many.samples is not None
    for row in range(3):
        alone = roll(topology, world, columns(plan)[:, row], dtype, steps, fps)
        for one in (alone, jax.tree.map(lambda leaf, row=row: leaf[..., row], few)):
            assert (one.success, one.steps, one.eliminations, one.fault) == (
                many.success[row],
                many.steps[row],
                many.eliminations[row],
                0,
            )
            pose = np.array([one.position.x[0], one.position.y[0], one.angle[0]])
            np.testing.assert_allclose(pose, many.samples[row, -1, -1], atol=1e-9 if dtype == "float64" else 0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("game", "dtype"), [("hole", "float32"), pytest.param("multi_ball_hole", "float64", marks=pytest.mark.further)]
)
def test_unused_room_changes_nothing(game: str, dtype: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """More contact slots, and more places for static bars than the scene has."""
    scene = load_scene(game)
    topology, world = compile_scene(scene, dtype=dtype)
    plan = columns(plans(game, 8, seed=2))
    played = roll(topology, lay([world] * 8), plan, dtype)
    assert not played.fault.any()
    wider = replace(topology, slots=topology.slots + 3)
    monkeypatch.setattr(builder, "STATIC_ROOM", builder.STATIC_ROOM + 4)
    roomier, padded = compile_scene(scene, dtype=dtype)
    assert roomier.num_static == topology.num_static + 4
    exact = {"rtol": 0, "atol": 0 if dtype == "float64" else 0.05}
    for other_topology, other in ((wider, world), (roomier, padded)):
        outcome = roll(other_topology, lay([other] * 8), plan, dtype)
        for name in ("done", "success", "steps", "eliminations", "fault"):
            np.testing.assert_array_equal(getattr(outcome, name), getattr(played, name))
        for one, two in zip(
            jax.tree.leaves((outcome.position, outcome.angle)),
            jax.tree.leaves((played.position, played.angle)),
            strict=True,
        ):
            np.testing.assert_allclose(one, two, **exact)


@pytest.mark.slow
@both
@pytest.mark.parametrize("fps", [10, 60])
def test_eliminated_blocks_touch_nothing(dtype: str, fps: int) -> None:
    """A scene whose first two blocks go before the first step is the scene without them."""
    here = [(100.0, 300.0, 400.0, 340.0), (150.0, 200.0, 350.0, 200.0), (420.0, 380.0, 560.0, 380.0)]
    ball = [(210.0, 150.0, 20.0)]
    options = {"fps": fps, "dtype": dtype, "sample_every": 1}
    full = simulate(make_scene(ball, here), [[-1, 0, -1], [0, 0, -1], [-1, -1, -1]], **options)
    for row, left in ((0, [here[0], here[2]]), (1, [here[2]])):
        bare = simulate(make_scene(ball, left), [[-1] * len(left)], **options)
        assert full.samples is not None
        assert bare.samples is not None
        assert (full.steps[row], full.success[row]) == (bare.steps[0], bare.success[0])
        np.testing.assert_array_equal(full.samples[row, :, -1], bare.samples[0, :, -1])
    assert np.abs(full.samples[2, :, -1] - full.samples[0, :, -1]).max() > 10  # the blocks do matter


@both
def test_a_removed_bar_lets_the_ball_fall(dtype: str) -> None:
    scene = make_scene([(300.0, 150.0, 20.0)], [(200.0, 200.0, 400.0, 200.0)])
    played = simulate(scene, [[0], [-1]], fps=60, dtype=dtype, sample_every=1)
    assert played.samples is not None
    steps = np.arange(int(played.steps[0]) + 1)
    fall = 150 + 100 / 3600 * steps * (steps - 1) / 2
    exact = {"rtol": 0, "atol": 1e-9 if dtype == "float64" else 0.02}
    np.testing.assert_allclose(played.samples[0, : len(steps), 1, 1], fall, **exact)
    np.testing.assert_array_equal(played.success, [True, False])
    assert np.isnan(played.samples[0, 1:, 0]).all()


GROOVE = [(100.0, 300.0, 300.0, 400.0), (300.0, 400.0, 500.0, 300.0)]  # a ball in it touches both bars


def lanes_with(middle: Scene, dtype: str) -> tuple[Topology, World]:
    """Return four worlds in lanes: balls that bounce on a bar, and `middle` as the third."""
    flat = [make_scene([(300.0, y, 20.0)], [(100.0, 400.0, 500.0, 420.0)]) for y in (150.0, 200.0, 250.0)]
    built = [compile_scene(scene, dtype=dtype) for scene in (*flat[:2], middle, flat[2])]
    assert len({topology for topology, _ in built}) == 1
    return built[0][0], lay([world for _, world in built])


@pytest.mark.slow
@both
def test_a_world_with_too_many_contacts_stops_alone(dtype: str) -> None:
    """One slot, and a ball that comes to touch two bars."""
    plan = np.full((PLAN_COLUMNS, 4), -1)
    outcomes = []
    for middle in (make_scene([(300.0, 200.0, 20.0)], GROOVE), make_scene([(300.0, 200.0, 20.0)], GROOVE[:1])):
        topology, world = lanes_with(middle, dtype)
        outcomes.append(roll(replace(topology, slots=1), world, plan, dtype))
    faulted, sound = outcomes
    np.testing.assert_array_equal(faulted.fault, [0, 0, rollouts.FAULT_OVERFLOW, 0])
    np.testing.assert_array_equal(sound.fault, 0)
    assert faulted.done[2]
    assert not faulted.success[2]
    assert 10 < faulted.steps[2] < STEPS
    others = [0, 1, 3]
    assert_same_bits(*(jax.tree.map(lambda leaf: leaf[..., others], outcome) for outcome in outcomes))
    topology, world = lanes_with(make_scene([(300.0, 200.0, 20.0)], GROOVE), dtype)
    assert roll(topology, world, plan, dtype).fault[2] == 0  # with all its slots the groove is sound


@both
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_world_that_is_not_finite_stops_alone(dtype: str, value: float) -> None:
    plan = np.full((PLAN_COLUMNS, 4), -1)
    topology, world = lanes_with(make_scene([(300.0, 200.0, 20.0)], GROOVE), dtype)
    sound = roll(topology, world, plan, dtype)
    x = world.start.x.copy()
    x[0, 2] = value
    faulted = roll(topology, replace(world, start=replace(world.start, x=x)), plan, dtype)
    np.testing.assert_array_equal(faulted.fault, [0, 0, rollouts.FAULT_NOT_FINITE, 0])
    assert faulted.steps[2] == 1
    assert not faulted.success[2]
    others = [0, 1, 3]
    assert_same_bits(*(jax.tree.map(lambda leaf: leaf[..., others], outcome) for outcome in (faulted, sound)))


def test_mixed_scenes_of_one_topology_share_a_chunk() -> None:
    """Bit for bit what each gives on its own."""
    games = ("hole", "support", "direction")
    which = np.arange(9) % 3
    plan = np.full((9, 4), -1)
    for k, game in enumerate(games):
        drawn = plans(game, 3, seed=k)
        plan[which == k, : drawn.shape[1]] = drawn
    mixed = simulate_many(games, which, plan, fps=FPS)
    for k, game in enumerate(games):
        mine = plan[which == k][:, : len(load_scene(game).eliminable_blocks)]
        alone = simulate(game, mine, fps=FPS)
        np.testing.assert_array_equal(mixed.steps[which == k], alone.steps)
        np.testing.assert_array_equal(mixed.reward[which == k], alone.reward)

"""Drawn scenes are valid, of few topologies, and a function of seed and number."""

import dataclasses
from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest

from iphyre_jax.data.generated import displaced, drawing, elements
from iphyre_jax.data.generated.canvas import BALLS, BARS, PIN, SPRING, Canvas, Element, place
from iphyre_jax.data.generated.displaced import displaced_games
from iphyre_jax.data.generated.drawing import KINDS, SceneKind, draw_chunk
from iphyre_jax.physics.constants import BAR_RADIUS
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, SPLITS, load_scene
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.scenes.geometry import TOLERANCE, Layouts, gaps, outside
from tests.cases import further_but

CHUNK = 320


@pytest.fixture(autouse=True, scope="module")
def small_chunks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drawing, "CHUNK", CHUNK)
        yield


@pytest.fixture(scope="module", params=further_but(KINDS, "elements"))
def kind(request: pytest.FixtureRequest) -> SceneKind:
    return cast(SceneKind, request.param)


@pytest.fixture(scope="module")
def chunk(small_chunks: None, kind: SceneKind) -> tuple[Canvas, np.ndarray, np.ndarray]:
    return draw_chunk(3, 1, kind)


def test_the_same_seed_draws_the_same_scenes(chunk: tuple[Canvas, np.ndarray, np.ndarray], kind: SceneKind) -> None:
    again, other = draw_chunk(3, 1, kind), draw_chunk(4, 1, kind)
    canvases = (vars(one[0]).values() for one in (chunk, again, other))
    for first, second, third in zip(*canvases, strict=True):
        np.testing.assert_array_equal(first, second)
        assert (first != third).any()
    np.testing.assert_array_equal(chunk[1], again[1])


def test_scenes_are_valid_and_of_few_topologies(chunk: tuple[Canvas, np.ndarray, np.ndarray], kind: SceneKind) -> None:
    canvas, whole, basic = chunk
    assert len(whole) > {"elements": 0.9, "unions": 0.4}[kind] * CHUNK
    scenes = [canvas.scene(row, f"s{row}") for row in whole]
    topologies = {topology_of(scene) for scene in scenes}
    if kind == "elements":
        assert len(topologies) == 15
    else:  # what moves is as in the others, but a ball that is tied may be the second
        assert len(topologies) >= 8
        known, rows, _ = draw_chunk(3, 1, "elements")
        assert len(topologies - {topology_of(known.scene(row, "known")) for row in rows}) <= 3
    for scene, row in zip(scenes, whole, strict=True):
        assert scene.n_objects <= MAX_OBJECTS
        assert 2 <= len(scene.eliminable_blocks) <= MAX_ELIMINABLE
        layout = Layouts.of(scene)
        assert outside(layout).max() <= TOLERANCE
        if basic[row] < 0:  # basic games have bars that overlap from the start
            assert gaps(layout).min() >= -TOLERANCE


def test_no_bar_is_turned_into_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(displaced, "TURN", 0.005)  # as long as the bar, so that it happens often
    blocks = np.array(load_scene("seesaw").blocks)
    blocks[0, 1] = blocks[0, 0] + [0.1, 0.0]
    short = dataclasses.replace(load_scene("seesaw"), blocks=blocks)
    drawn = displaced_games([short], np.zeros(2000, int), np.random.default_rng(0))
    assert np.linalg.norm(drawn.ends[:, 0, 0] - drawn.ends[:, 0, 1], axis=-1).min() > 0


def test_balls_touch_nothing_at_the_start(chunk: tuple[Canvas, np.ndarray, np.ndarray]) -> None:
    canvas, whole, _ = chunk
    ends, radii = canvas.ends[whole], canvas.radii[whole]
    for ball in range(BARS, BARS + BALLS):
        rows = np.flatnonzero(canvas.used[whole, ball])
        apart = canvas.gaps(whole[rows], ends[rows, ball, None], radii[rows, ball, None])[:, 0]
        apart[:, ball] = np.inf
        assert apart.min(initial=np.inf) >= -TOLERANCE


def test_a_union_has_what_moves_in_its_games(small_chunks: None) -> None:
    canvas, whole, basic = draw_chunk(5, 0, "unions")
    games = [load_scene(name) for name in SPLITS["basic"]]
    more = 0
    for row in whole:
        first = games[basic[row]]
        assert canvas.moving[row, :BARS].sum() >= first.dynamic[: first.n_blocks].sum()
        assert len(first.joints) <= (canvas.link[row] == PIN).sum()
        assert len(first.springs) <= (canvas.link[row] == SPRING).sum()
        more += canvas.balls[row] > 1
    assert 0.3 < more / len(whole) < 0.9


def test_displaced_games_keep_their_objects_and_move_all_of_them() -> None:
    games = [load_scene(name) for name in SPLITS["basic"]]
    which = np.arange(100) % 10
    scenes = displaced_games(games, which, np.random.default_rng(0))
    for row, game in enumerate(which):
        scene = scenes.scene(row, "moved")
        for field in ("eliminable", "dynamic"):
            np.testing.assert_array_equal(getattr(scene, field), getattr(games[game], field))
        assert (scene.joints, scene.springs) == (games[game].joints, games[game].springs)
        assert not (scene.blocks == games[game].blocks).all(axis=(1, 2)).any()
        own, before = gaps(Layouts.of(scene))[0], gaps(Layouts.of(games[game]))[0]
        assert (own >= np.minimum(before, 0.0) - 2e-6).all()


def test_an_element_goes_where_it_fits_and_nowhere_else() -> None:
    canvas, rng = Canvas.empty(2), np.random.default_rng(0)
    wall = np.array([[[100.0, 300.0], [500.0, 300.0]]])

    def bar(_: np.random.Generator, n: int) -> Element:
        return Element(np.repeat(wall[None], n, axis=0), np.zeros((n, 1), bool))

    def near(_: np.random.Generator, n: int) -> Element:
        return Element(np.repeat(wall[None], n, axis=0) - [0.0, 2 * BAR_RADIUS], np.ones((n, 1), bool))

    def clear(_: np.random.Generator, n: int) -> Element:
        return Element(np.repeat(wall[None], n, axis=0) - [0.0, 2 * BAR_RADIUS + 2], np.ones((n, 1), bool))

    assert place(canvas, rng, np.array([0]), bar).tolist() == []
    assert place(canvas, rng, np.array([0, 1]), near).tolist() == [0]  # it would touch
    assert place(canvas, rng, np.array([0]), clear).tolist() == []
    assert canvas.bars.tolist() == [2, 1]
    assert canvas.eliminable[:, :2].tolist() == [[False, True], [True, False]]


def test_no_scene_has_more_than_the_official_number_of_blocks() -> None:
    canvas, rng = Canvas.empty(1), np.random.default_rng(0)
    left = [place(canvas, rng, np.array([0]), elements.distractor, tries=8).size for _ in range(30)]
    assert canvas.eliminable.sum() <= MAX_ELIMINABLE
    assert canvas.bars[0] <= 10  # static bars that share a program
    assert sum(left) >= 20

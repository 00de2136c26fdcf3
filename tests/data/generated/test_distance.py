"""The distance to the test games: worked by hand, and against a slow count of its own."""

import numpy as np
import pytest

from iphyre_jax.data.generated import chunks, drawing, load_generated
from iphyre_jax.data.generated.canvas import Canvas
from iphyre_jax.data.generated.distance import NEAREST, TEST_SPLITS, distances_to_test_games
from iphyre_jax.data.generated.filtering import KEPT, NEAR
from iphyre_jax.data.generated.pool import GeneratorSettings
from iphyre_jax.envs.protocols import PROTOCOLS
from iphyre_jax.scenes import GAMES, SPLITS, Scene, load_scene, vary

HELD_BACK = tuple(name for split in TEST_SPLITS for name in SPLITS[split])


def canvas_of(*scenes: Scene) -> Canvas:
    canvas = Canvas.empty(len(scenes))
    for row, scene in enumerate(scenes):
        canvas.write(row, scene)
    return canvas


def test_all_games_but_the_basic_ones_are_held_back() -> None:
    assert set(HELD_BACK) == {*GAMES, *SPLITS["unseen_basic"]} - set(SPLITS["basic"])


def comparable(scene: Scene) -> bool:
    return scene.n_blocks <= 11 and scene.n_balls <= 3


@pytest.mark.parametrize("name", [name for name in HELD_BACK if comparable(load_scene(name))])
def test_a_test_game_is_found_mirrored_shifted_and_jittered(name: str) -> None:
    game = load_scene(name)
    assert distances_to_test_games(canvas_of(game))[0] == pytest.approx(0.0, abs=1e-9)
    drawn = vary(game, 200, seed=1, shift_px=40, jitter_px=NEAREST / 4)
    assert distances_to_test_games(canvas_of(*drawn.scenes[:20])).max(initial=0.0) < NEAREST


@pytest.mark.slow
def test_no_shipped_scene_is_near_a_test_game() -> None:
    shipped = load_generated("shipped")
    found = distances_to_test_games(canvas_of(*shipped.scenes))
    assert len(found) == 4000
    assert found.min() >= NEAREST
    np.testing.assert_allclose(found, shipped.columns["distance"], rtol=0, atol=1e-9)
    assert shipped.manifest["nearest_px"] == found.min()


def test_a_displacement_by_hand() -> None:
    """One of three objects moves by 90 px: the mean moves by 30, so 60 px are left of it, and 30 of the others."""
    game = load_scene("unseen_support")
    assert game.n_objects == 3
    moved = Scene(**{**vars(game), "balls": np.add(game.balls, [0.0, 90.0, 0.0])})
    assert distances_to_test_games(canvas_of(moved))[0] == pytest.approx(60.0)


def test_other_numbers_of_objects_are_not_compared() -> None:
    game = load_scene("support")
    more = Scene(**{**vars(game), "balls": [*game.balls, (100, 100, 20), (500, 100, 20)], "eliminable": [1, 1, 0, 0, 0],
                    "dynamic": [0, 0, 1, 1, 1]})  # fmt: skip
    assert distances_to_test_games(canvas_of(more)).tolist() == [np.inf]


def slow_distance(scene: Scene, game: Scene) -> float:
    """The same distance, object by object."""

    def objects(one: Scene, mirrored: bool) -> list[tuple[object, np.ndarray, float]]:
        flags = (one.eliminable[: one.n_blocks], one.dynamic[: one.n_blocks])
        bars: list[tuple[object, np.ndarray, float]] = [
            (("bar", e, d), ends, 10.0) for ends, e, d in zip(one.blocks, *flags, strict=True)
        ]
        found = bars + [("ball", np.array([ball[:2], ball[:2]]), ball[2]) for ball in one.balls]
        if mirrored:
            found = [(kind, np.array([600.0, 0.0]) + ends * [-1, 1], radius) for kind, ends, radius in found]
        mean = np.mean([ends for _, ends, _ in found], axis=(0, 1))
        return [(kind, ends - mean, radius) for kind, ends, radius in found]

    def apart(a: tuple[object, np.ndarray, float], b: tuple[object, np.ndarray, float]) -> float:
        if a[0] != b[0]:
            return np.inf
        ways = [max(np.linalg.norm(a[1] - ends, axis=1)) for ends in (b[1], b[1][::-1])]
        return float(max(min(ways), abs(a[2] - b[2])))

    best, own = np.inf, objects(scene, mirrored=False)
    for mirrored in (False, True):
        its = objects(game, mirrored)
        if sorted(str(kind) for kind, *_ in own) == sorted(str(kind) for kind, *_ in its):
            pairs = np.array([[apart(a, b) for b in its] for a in own])
            best = min(best, max(pairs.min(axis=0).max(), pairs.min(axis=1).max()))
    return best


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "least"), [("elements", 300), pytest.param("unions", 150, marks=pytest.mark.further)])
def test_no_scene_that_is_played_is_near_a_test_game(
    kind: drawing.SceneKind, least: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (drawing, chunks):
        monkeypatch.setattr(module, "CHUNK", 512)
    drawn = chunks._draw(GeneratorSettings(5, PROTOCOLS["official"], kind), 0)
    played = np.flatnonzero(drawn.reason == KEPT)
    assert len(drawn.scenes) == len(played) > least
    games = [load_scene(name) for name in HELD_BACK]
    slow = np.array([min(slow_distance(scene, game) for game in games) for scene in drawn.scenes[::7]])
    np.testing.assert_allclose(slow, drawn.distance[played[::7]], atol=1e-6)
    assert drawn.distance[played].min() >= NEAREST
    refused = drawn.distance[drawn.reason == NEAR]
    assert (refused < NEAREST).all()

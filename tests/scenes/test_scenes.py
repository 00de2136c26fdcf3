"""The games of the package, and reading and writing of scene files."""

import copy
import dataclasses
import hashlib
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from iphyre_jax import GAMES, SPLITS, Scene, load_scene
from iphyre_jax.scenes import read_scene, scene_from_dict, scene_to_dict, write_scene

ALL_GAMES = [game for games in SPLITS.values() for game in games]
SHARED = Path(__file__).parents[2].parent / "shared" / "data" / "games.json"
LAYOUTS_SHA256 = "2b3b35107b44d6bc9fd3c399bf037d2fcb7d39e8638f02c71d49c10d650a8331"


def layouts() -> dict[str, object]:
    """Return the splits and all games as the package reads them, with the field names of scene files."""
    fields = ("block", "ball", "eli", "dynamic", "joint", "spring")
    games = {name: scene_to_dict(load_scene(name)) for name in ALL_GAMES}
    return {
        "splits": {split: list(names) for split, names in SPLITS.items()},
        "games": {name: {field: game[field] for field in fields if game[field]} for name, game in games.items()},
    }


def test_layouts_are_those_of_the_official_package() -> None:
    canonical = json.dumps(layouts(), sort_keys=True, separators=(",", ":"))
    assert hashlib.sha256(canonical.encode()).hexdigest() == LAYOUTS_SHA256


@pytest.mark.skipif(not SHARED.is_file(), reason="the table that the layouts were taken from is not at hand")
def test_layouts_equal_their_source() -> None:
    source = json.loads(SHARED.read_text())
    assert layouts() == {"splits": source["splits"], "games": source["games"]}


def test_splits_and_games_keep_their_order() -> None:
    assert tuple(SPLITS) == ("basic", "noisy", "compositional", "multi_ball", "unseen_basic")
    assert [len(names) for names in SPLITS.values()] == [10] * 5
    assert list(GAMES) == ALL_GAMES[:40]
    assert (GAMES[0], GAMES[10], GAMES[39]) == ("support", "noisy_support", "multi_ball_spring_flick")
    assert set(SPLITS["unseen_basic"]).isdisjoint(GAMES)
    assert len(set(ALL_GAMES)) == 50


def test_splits_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        SPLITS["basic"] = ()  # type: ignore[index]


@pytest.mark.parametrize("name", ALL_GAMES)
def test_every_game_round_trips_through_a_file(name: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    write_scene(load_scene(name), path)
    assert read_scene(path) == load_scene(path) == load_scene(str(path)) == load_scene(name)
    assert [file.name for file in tmp_path.iterdir()] == ["scene.json"]


def test_fields_of_a_game() -> None:
    scene = load_scene("multi_ball_pendulum")
    assert (scene.n_blocks, scene.n_balls, scene.n_objects) == (8, 2, 10)
    assert scene.blocks.shape == (8, 2, 2)
    assert scene.balls.shape == (2, 3)
    assert (scene.blocks.dtype, scene.balls.dtype) == (np.float64, np.float64)
    assert (scene.eliminable.dtype, scene.dynamic.dtype) == (np.bool_, np.bool_)
    assert scene.joints == ((6, 8), (5, 9))
    assert scene.springs == ()
    assert scene.eliminable_blocks == tuple(np.flatnonzero(scene.eliminable))


def test_load_scene_returns_what_it_has() -> None:
    scene = load_scene("hole")
    assert load_scene("hole") is scene
    assert load_scene(scene) is scene


def test_scene_cannot_be_changed() -> None:
    scene = load_scene("hole")
    with pytest.raises(ValueError, match="read-only"):
        scene.blocks[0, 0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.name = "other"  # type: ignore[misc]


def test_a_scene_from_another_process_cannot_be_changed_either() -> None:
    scene = load_scene("pendulum")
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):  # noqa: S301 - our own bytes
        assert other == scene
        assert not any(array.flags.writeable for array in (other.blocks, other.balls, other.eliminable, other.dynamic))


def test_scene_keeps_no_hold_on_the_callers_arrays() -> None:
    blocks = np.array([[[0.0, 0.0], [50.0, 0.0]]])
    scene = Scene("mine", blocks, np.array([[25.0, -40.0, 20.0]]), np.array([1, 0]), np.array([False, True]))
    blocks[0, 0, 0] = 7.0
    assert scene.blocks[0, 0, 0] == 0.0


def test_replace_validates_anew() -> None:
    scene = load_scene("hole")
    assert dataclasses.replace(scene, name="mine").n_objects == scene.n_objects
    with pytest.raises(ValueError, match=r"^Scene 'hole': dynamic: expected 7 entries"):
        dataclasses.replace(scene, dynamic=scene.dynamic[:-1])


def test_equality_and_hash_follow_the_contents() -> None:
    scene = load_scene("hole")
    copy = scene_from_dict(scene_to_dict(scene))
    assert copy == scene
    assert hash(copy) == hash(scene)
    assert dataclasses.replace(scene, name="mine") != scene
    assert scene != "hole"


def test_numbers_may_be_numpys() -> None:
    data = scene_to_dict(load_scene("seesaw"))
    data |= {"ball": load_scene("seesaw").balls, "eli": [np.int64(flag) for flag in data["eli"]]}
    assert scene_from_dict(data) == load_scene("seesaw")


def test_a_scene_without_blocks_is_sound() -> None:
    scene = Scene("fall", np.zeros((0, 2, 2)), np.array([[300.0, 100.0, 20.0]]), np.array([False]), np.array([True]))
    assert (scene.blocks.shape, scene.eliminable_blocks) == ((0, 2, 2), ())


def test_a_game_wins_over_a_folder_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "hole").mkdir()
    write_scene(load_scene("fill"), tmp_path / "my_scene")
    monkeypatch.chdir(tmp_path)
    assert load_scene("hole").name == "hole"
    assert load_scene("my_scene").name == "fill"


COORDINATES = st.floats(-10_000, 10_000)
NAMES = st.text(st.characters(categories=["L", "N", "P"]), min_size=1, max_size=100)


@st.composite
def scene_dicts(draw: st.DrawFn) -> dict[str, object]:
    """Draw a valid scene: bars (some eliminable, some moving), balls, and pairs with at least one moving object."""
    points = st.tuples(COORDINATES, COORDINATES)
    bars = draw(st.lists(st.tuples(points, points).filter(lambda bar: np.hypot(*np.subtract(*bar)) > 0.01), max_size=8))
    balls = draw(st.lists(st.tuples(COORDINATES, COORDINATES, st.floats(0.001, 10_000)), min_size=1, max_size=4))
    kinds = draw(st.lists(st.sampled_from(["fixed", "moving", "eliminable"]), min_size=len(bars), max_size=len(bars)))
    while kinds.count("eliminable") > 6:
        kinds[kinds.index("eliminable")] = "fixed"
    dynamic = [int(kind == "moving") for kind in kinds] + [1] * len(balls)
    count = len(dynamic)
    pairs = [[a, b] for a in range(count) for b in range(a) if dynamic[a] or dynamic[b]]
    springs = draw(st.lists(st.sampled_from(pairs), unique_by=tuple)) if pairs else []
    return {
        "schema": "iphyre_jax/scene",
        "version": 1,
        "name": draw(NAMES),
        "block": [[list(start), list(end)] for start, end in bars],
        "ball": [list(ball) for ball in balls],
        "eli": [int(kind == "eliminable") for kind in kinds] + [0] * len(balls),
        "dynamic": dynamic,
        "joint": [],
        "spring": springs,
    }


@given(scene_dicts())
def test_any_valid_scene_loads_and_round_trips(data: dict[str, object]) -> None:
    scene = scene_from_dict(data)
    assert scene_to_dict(scene) == data
    assert scene_from_dict(json.loads(json.dumps(scene_to_dict(scene)))) == scene
    assert sum(scene.eliminable) == len(scene.eliminable_blocks) <= 6


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda children: st.lists(children, max_size=4) | st.dictionaries(st.text(), children, max_size=4),
    max_leaves=12,
)


FIELDS = ("name", "block", "ball", "eli", "dynamic", "joint", "spring")


@given(st.sampled_from(FIELDS), JSON_VALUES)
def test_any_value_in_any_field_is_taken_or_told(field: str, value: object) -> None:
    lines = told(scene_to_dict(load_scene("pendulum")) | {field: value})
    starts = tuple(f"file: {name}" for name in FIELDS)  # a list of wrong length is told where it fails to fit
    assert all(line.startswith(starts) and ": expected " in line for line in lines)


def told(data: object) -> list[str]:
    """Return the lines of the error for these data; none if they are a valid scene."""
    try:
        scene = scene_from_dict(data, "file")
    except ValueError as error:
        return str(error).split("\n")
    assert isinstance(scene, Scene)
    return []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (".", "path: expected the name of a file, got the folder '.'"),
        ("no/scene.json", "path: expected a file in a folder that exists, got 'no/scene.json'"),
    ],
)
def test_a_scene_goes_to_a_file_in_a_folder_that_exists(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=f"^{message}$"):
        write_scene(load_scene("fill"), name)

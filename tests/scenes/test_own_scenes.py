"""Own scenes: builder, geometry, variations, JSON Schema, and the command that checks files."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax import GAMES, SPLITS, SceneBuilder, load_scene, scenes, simulate, vary
from iphyre_jax.cli.main import run
from iphyre_jax.scenes import Scene, read_scene, scene_json_schema, scene_to_dict, write_scene
from iphyre_jax.scenes.compile import topology_of
from iphyre_jax.scenes.geometry import Layouts, gaps, outside, scene_warnings
from iphyre_jax.scenes.variations import add_blocks, jitter, mirror, scale, shift

ALL_GAMES = [game for games in SPLITS.values() for game in games]


def built() -> Scene:
    builder = SceneBuilder("own")
    ball = builder.ball((250, 340))  # added before the blocks, but its index comes after theirs
    shelf = builder.block((200, 400), (300, 400), eliminable=True)
    builder.block((200, 500), (300, 500), dynamic=True)
    builder.joint(shelf, ball)
    builder.spring(ball, shelf)
    return builder.build()


def test_builder_counts_blocks_first() -> None:
    scene = built()
    assert scene.joints == ((0, 2),)
    assert scene.springs == ((2, 0),)
    assert scene.eliminable.tolist() == [True, False, False]
    assert scene.dynamic.tolist() == [False, True, True]
    assert topology_of(scene).moving == 2  # `test_limits` plays a scene that was built


def test_builder_refuses_what_is_wrong() -> None:
    builder = SceneBuilder("own")
    builder.block((0, 0), (0, 0), eliminable=True, dynamic=True)
    with pytest.raises(ValueError, match="expected at least one ball"):
        builder.build()
    ball, other = builder.ball((300, 300)), SceneBuilder("other")
    foreign = other.ball((200, 200))
    for tie in (other.joint, other.spring):
        with pytest.raises(ValueError, match=r"^second: expected an object of this builder, got one of another$"):
            tie(foreign, ball)


def test_variations_of_a_long_name_have_names_of_their_own() -> None:
    scene = dataclasses.replace(load_scene("hole"), name="h" * 100)
    drawn = vary(scene, 12, seed=12, shift_px=5).scenes
    assert len({one.name for one in drawn}) == len(drawn) > 1
    assert {len(one.name) for one in drawn} == {100}


def test_the_old_name_of_object_ref_warns() -> None:
    with pytest.warns(DeprecationWarning, match="ObjectRef"):
        assert scenes.Part is scenes.ObjectRef
    with pytest.raises(AttributeError):
        _ = scenes.Parts


def layout(*bars: Any, ball: Any = (500, 500, 20)) -> Layouts:
    return Layouts(np.array([bars], float).reshape(1, -1, 2, 2), np.array([[ball]], float))


@pytest.mark.parametrize(
    ("bars", "gap"),
    [
        (([[0, 0], [100, 0]], [[0, 50], [100, 50]]), 30),  # side by side
        (([[0, 0], [100, 0]], [[130, 40], [200, 40]]), 30),  # from end to end, 3-4-5
        (([[0, 0], [100, 0]], [[50, -50], [50, 50]]), -20),  # crossing
        (([[0, 0], [100, 0]], [[50, 0], [200, 0]]), -20),  # on one line
        (([[0, 0], [100, 0]], [[120, 0], [200, 0]]), 0),  # touching
        (([[0, 0], [100, 0]], [[50, 30], [50, 90]]), 10),  # an end above the middle
    ],
)
def test_gaps_by_hand(bars: Any, gap: float) -> None:
    found = gaps(layout(*bars))[0]
    np.testing.assert_allclose([found[0, 1], found[1, 0]], gap, atol=1e-12)
    assert found[0, 0] == np.inf


def test_what_sticks_out_by_hand() -> None:
    np.testing.assert_allclose(outside(layout([[5, 300], [595, 300]], ball=(300, 590, 20)))[0], [5, 10])


def test_the_games_are_inside_and_only_one_has_overlaps() -> None:
    odd = {game: scene_warnings(load_scene(game)) for game in ALL_GAMES if scene_warnings(load_scene(game))}
    assert odd == {
        "multi_ball_hinder": ["ball[0]: overlaps block[4] by 3.50005 px", "ball[1]: overlaps block[5] by 3.50005 px"]
    }


def test_operations_by_hand() -> None:
    one = layout([[100, 200], [150, 220]])
    assert mirror(one, np.array([True])).bars.tolist() == [[[[500, 200], [450, 220]]]]
    assert mirror(one, np.array([False])).bars.tolist() == one.bars.tolist()
    assert shift(one, np.array([[3.0, -4.0]])).balls.tolist() == [[[503, 496, 20]]]
    assert scale(one, np.array([0.5])).bars.tolist() == [[[[200, 250], [225, 260]]]]
    moved = jitter(one, np.array([[[1.0, 2.0]]]), np.array([[[-1.0, -2.0]]]))
    assert moved.bars.tolist() == [[[[101, 202], [151, 222]]]]
    assert moved.balls.tolist() == [[[499, 498, 20]]]
    added = add_blocks(one, np.array([[[[0.0, 1.0], [2.0, 3.0]]]]))
    assert added.bars.shape == (1, 2, 2, 2)


@pytest.mark.parametrize("game", ["support", "hole", "pendulum", "multi_ball_hinder", "spring"])
def test_variations_are_valid_or_refused_with_a_reason(game: str) -> None:
    scene = load_scene(game)
    drawn = vary(scene, 60, seed=1, shift_px=30, scale_by=1.2, jitter_px=4, extra_blocks=1)
    assert len(drawn.scenes) + len(drawn.refused) == 60
    assert drawn.scenes
    for reason in drawn.refused:
        assert "sticks out of the picture by" in reason or "overlap by" in reason
    for one in drawn.scenes:
        assert outside(Layouts.of(one)).max() <= 1e-6
        assert one.n_blocks == scene.n_blocks + 1
        assert len(one.eliminable_blocks) == len(scene.eliminable_blocks)
        assert [[j - one.n_blocks for j in pair if j >= one.n_blocks] for pair in one.joints] == [
            [j - scene.n_blocks for j in pair if j >= scene.n_blocks] for pair in scene.joints
        ]
        worst = gaps(Layouts.of(one)).min()
        assert worst >= min(0, gaps(Layouts.of(scene)).min()) - 1e-6
        assert topology_of(one) == topology_of(scene)
    again = vary(scene, 60, seed=1, shift_px=30, scale_by=1.2, jitter_px=4, extra_blocks=1)
    assert again.scenes == drawn.scenes
    assert again.refused == drawn.refused
    assert vary(scene, 60, seed=2, shift_px=30).scenes != vary(scene, 60, seed=1, shift_px=30).scenes


def test_a_mirrored_game_plays_mirrored() -> None:
    scene = load_scene("hole")
    other = next(one for one in vary(scene, 8, seed=0).scenes if one.blocks[0, 0, 0] != scene.blocks[0, 0, 0])
    plan = [[-1, -1, 83, 33]]
    plays = [simulate(one, plan, dtype="float64", sample_every=100) for one in (scene, other)]
    assert plays[0].reward[0] == plays[1].reward[0]
    np.testing.assert_allclose(plays[0].samples[0, :, -1, 0], 600 - plays[1].samples[0, :, -1, 0], atol=1e-6)


BAD_VARIATIONS: dict[str, tuple[dict[str, Any], str]] = {
    "count": ({"count": 0}, "count: expected a whole number of at least 1"),
    "count type": ({"count": 1.5}, "count: expected a whole number"),
    "seed": ({"seed": -1}, "seed: expected a whole number of at least 0"),
    "shift": ({"shift_px": -1.0}, "shift_px: expected a finite number of at least 0"),
    "shift nan": ({"shift_px": float("nan")}, "shift_px: expected a finite number"),
    "scale": ({"scale_by": 0.9}, "scale_by: expected a finite number of at least 1"),
    "jitter": ({"jitter_px": float("inf")}, "jitter_px: expected a finite number"),
    "extra": ({"extra_blocks": 10}, "extra_blocks: expected at most 9 for support, got 10"),
    "extra type": ({"extra_blocks": True}, "extra_blocks: expected a whole number"),
}


@pytest.mark.parametrize("case", BAD_VARIATIONS)
def test_bad_variations_get_one_line(case: str) -> None:
    options, message = BAD_VARIATIONS[case]
    with pytest.raises(ValueError, match=message) as caught:
        vary(load_scene("support"), **({"count": 1} | options))
    assert "\n" not in str(caught.value)


def conforms(value: Any, schema: dict[str, Any]) -> bool:
    """Check a value against the keywords that the schema of scenes uses."""
    if "const" in schema or "enum" in schema:
        return value in schema.get("enum", [schema.get("const")])
    kinds = {"array": list, "object": dict, "string": str, "integer": int, "number": int | float}
    if not isinstance(value, kinds[schema["type"]]) or isinstance(value, bool):
        return False
    if isinstance(value, list):
        items = schema.get("prefixItems") or [schema["items"]] * len(value)
        size = schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value))
        return size and all(conforms(one, item) for one, item in zip(value, items, strict=True))
    if isinstance(value, dict):
        known = schema["properties"]
        if "if" in schema and not set(schema["if"]["not"]["required"]) <= set(value):
            known = {key: field | schema["then"]["properties"].get(key, {}) for key, field in known.items()}
        whole = set(schema["required"]) <= set(value) <= set(known)
        return whole and all(conforms(one, known[key]) for key, one in value.items())
    if isinstance(value, str):
        return schema["minLength"] <= len(value) <= schema["maxLength"]
    return schema["minimum"] <= value <= schema["maximum"]


def test_the_schema_holds_for_the_games_and_not_for_others() -> None:
    schema = scene_json_schema()
    json.dumps(schema)
    for game in ALL_GAMES:
        assert conforms(scene_to_dict(load_scene(game)), schema)
    good = scene_to_dict(load_scene("spring"))
    for change in (
        {"version": 2},
        {"name": ""},
        {"ball": []},
        {"ball": [[1, 2]]},
        {"eli": [2] * 7},
        {"block": [[[1, 2], [3, "4"]]]},
        {"block": [[[1, 2], [3, 1e5]]]},
        {"spring": [[0, 12]]},
        {"block": [[[0, 50 * k], [9, 50 * k]] for k in range(13)]},
        {"limits": {"objects": 11}},
        {"colour": "red"},
    ):
        assert not conforms(good | change, schema)
    assert conforms(good | {"spring": [[0, 12]], "limits": {"objects": 15, "blocks": 8}}, schema)
    assert not conforms({key: value for key, value in good.items() if key != "eli"}, schema)


def test_scene_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, odd, bad = tmp_path / "good.json", tmp_path / "odd.json", tmp_path / "bad.json"
    write_scene(built(), good)
    assert read_scene(good) == built()
    write_scene(load_scene("multi_ball_hinder"), odd)
    bad.write_text('{"schema": "iphyre_jax/scene", "version": 1, "name": "x", "block": [], "ball": [[1, 2, 0]]}')
    assert run(["scene", "check", str(good), str(odd)]) == 0
    out = capsys.readouterr().out
    assert f"{good}: valid, own: 2 blocks (1 eliminable, 1 moving), 1 balls, 1 joints, 1 springs" in out
    assert f"{odd}: ball[0]: overlaps block[4] by 3.50005 px" in out
    assert f"{odd}: name: multi_ball_hinder is a game of the package" in out
    assert f"{good}: name" not in out
    assert run(["scene", "check", str(bad), str(tmp_path / "none.json"), str(good)]) == 2
    captured = capsys.readouterr()
    assert "bad.json: eli: expected this field, but it is missing" in captured.err
    assert "none.json: expected a scene file, but there is none" in captured.err
    assert "good.json: valid" in captured.out
    assert "Traceback" not in captured.err
    assert run(["scene", "check"]) == 2
    assert run(["scene", "schema"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "I-PHYRE scene"


def test_games_are_forty() -> None:
    assert set(GAMES) < set(ALL_GAMES)

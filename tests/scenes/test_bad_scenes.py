"""Each mistake in a scene gives one line that names the file, the field and the expected value."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from iphyre_jax.scenes import Scene, load_scene, scene_from_dict

Change = Callable[[dict[str, Any]], object]


def valid_scene() -> dict[str, Any]:
    """Two eliminable bars (0, 1), a static one (2), a dynamic one (3) and a ball (4), with a joint and a spring."""
    return {
        "schema": "iphyre_jax/scene",
        "version": 1,
        "name": "sound",
        "block": [[[200, 400], [300, 400]], [[200, 500], [300, 500]], [[50, 50], [90, 50]], [[100, 100], [100, 180]]],
        "ball": [[250, 340, 20]],
        "eli": [1, 1, 0, 0, 0],
        "dynamic": [0, 0, 0, 1, 1],
        "joint": [[2, 3]],
        "spring": [[3, 4]],
    }


def put(value: object, field: str, *where: int) -> Change:
    """Return a change that sets a field, or an entry of it."""

    def change(scene: dict[str, Any]) -> None:
        owner, key = scene, field
        for index in where:
            owner, key = owner[key], index
        owner[key] = value

    return change


def drop(field: str) -> Change:
    return lambda scene: scene.pop(field)


def bars_and_balls(bars: int, balls: int, eliminable: int) -> Change:
    """Return a change to a scene with these numbers of bars, in a column, and balls, in a row."""

    def change(scene: dict[str, Any]) -> None:
        scene["block"] = [[[10, 30 * i], [60, 30 * i]] for i in range(bars)]
        scene["ball"] = [[100 + 30 * i, 10, 5] for i in range(balls)]
        scene["eli"] = [int(i < eliminable) for i in range(bars + balls)]
        scene["dynamic"] = [int(i >= bars) for i in range(bars + balls)]
        scene["joint"] = scene["spring"] = []

    return change


def pin_without_length(scene: dict[str, Any]) -> None:
    """Pin the ball to the bar; both have the same centre."""
    scene["ball"], scene["joint"] = [[100, 140, 20]], [[3, 4]]


PX = "expected a finite number of px from -10000 to 10000, got "
NO_BAR = "expected a bar [[x1, y1], [x2, y2]], got "
NO_PAIR = "expected a pair of object indices [a, b], got "
NO_NAME = "name: expected a text of 1 to 100 printable characters without blanks at its ends, got "

BAD: list[tuple[str, Change, str]] = [
    # envelope
    ("no schema", drop("schema"), "schema: expected 'iphyre_jax/scene', got None"),
    (
        "library schema",
        put("iphyre_jax/scenes", "schema"),
        "schema: expected 'iphyre_jax/scene', got 'iphyre_jax/scenes'",
    ),
    ("no version", drop("version"), "version: expected 1, got None"),
    ("later version", put(2, "version"), "version: expected 1, got 2"),
    ("version true", put(True, "version"), "version: expected 1, got True"),
    ("misspelt field", put([], "springs"), "'springs': expected no such field (did you mean spring?)"),
    (
        "foreign field",
        put(1, "qqq"),
        "'qqq': expected no such field "
        "(known are schema, version, name, block, ball, eli, dynamic, joint, spring, limits)",
    ),
    # name
    ("no name", drop("name"), NO_NAME + "None"),
    ("empty name", put("", "name"), NO_NAME + "''"),
    ("name a number", put(7, "name"), NO_NAME + "7"),
    ("name of two lines", put("a\nb", "name"), NO_NAME + "'a\\nb'"),
    ("name padded", put(" a", "name"), NO_NAME + "' a'"),
    ("name too long", put("n" * 101, "name"), NO_NAME + "'" + "n" * 56 + "..."),
    # blocks
    ("no block", drop("block"), "block: expected this field, but it is missing"),
    ("block null", put(None, "block"), "block: expected a list of bars [[x1, y1], [x2, y2]], got None"),
    (
        "block an object",
        put({"a": 1}, "block"),
        "block: expected a list of bars [[x1, y1], [x2, y2]], got an object of 1 fields",
    ),
    ("bar a number", put(3, "block", 1), f"block[1]: {NO_BAR}3"),
    ("bar of one point", put([[1, 2]], "block", 1), f"block[1]: {NO_BAR}a list of 1"),
    ("bar flat", put([1, 2, 3, 4], "block", 2), f"block[2]: {NO_BAR}a list of 4"),
    ("point of three", put([1, 2, 3], "block", 2, 0), "block[2][0]: expected an end point [x, y], got a list of 3"),
    ("point a text", put("12", "block", 2, 0), "block[2][0]: expected an end point [x, y], got '12'"),
    ("coordinate a text", put("50", "block", 2, 0, 1), f"block[2][0][1]: {PX}'50'"),
    ("coordinate true", put(True, "block", 2, 0, 1), f"block[2][0][1]: {PX}True"),
    ("coordinate null", put(None, "block", 2, 0, 1), f"block[2][0][1]: {PX}None"),
    ("coordinate NaN", put(float("nan"), "block", 2, 0, 1), f"block[2][0][1]: {PX}nan"),
    ("coordinate infinite", put(float("-inf"), "block", 2, 0, 1), f"block[2][0][1]: {PX}-inf"),
    ("coordinate 1e308", put(1e308, "block", 2, 0, 1), f"block[2][0][1]: {PX}1e+308"),
    ("coordinate of 400 digits", put(10**400, "block", 2, 0, 1), f"block[2][0][1]: {PX}an integer of 1329 bits"),
    ("coordinate nested deep", put([[[[[[1]]]]]], "block", 2, 0, 1), f"block[2][0][1]: {PX}a list of 1"),
    (
        "bar without length",
        put([[1, 2], [1, 2]], "block", 1),
        "block[1]: expected end points at least 0.001 px apart, got 0 px",
    ),
    ("thirteen blocks", put([[[1, 2], [3, 4]]] * 13, "block"), "block: expected at most 12 entries, got a list of 13"),
    # balls
    ("no ball field", drop("ball"), "ball: expected this field, but it is missing"),
    ("no ball at all", bars_and_balls(2, 0, 1), "ball: expected at least one ball, got none"),
    ("ball a point", put([250, 340], "ball", 0), "ball[0]: expected a ball [x, y, radius], got a list of 2"),
    ("ball unwrapped", put([250, 340, 20], "ball"), "ball: expected a list of balls [x, y, radius], got a list of 3"),
    ("ball's place a text", put("a", "ball", 0, 0), f"ball[0][0]: {PX}'a'"),
    ("radius zero", put(0, "ball", 0, 2), "ball[0][2]: expected a radius of at least 0.001 px, got 0"),
    ("radius negative", put(-20.0, "ball", 0, 2), "ball[0][2]: expected a radius of at least 0.001 px, got -20"),
    ("radius infinite", put(float("inf"), "ball", 0, 2), f"ball[0][2]: {PX}inf"),
    ("thirteen objects", bars_and_balls(11, 2, 3), "block: expected at most 12 objects, got 11 blocks and 2 balls"),
    # flags
    ("no eli", drop("eli"), "eli: expected this field, but it is missing"),
    ("no dynamic", drop("dynamic"), "dynamic: expected this field, but it is missing"),
    ("eli a number", put(1, "eli"), "eli: expected a list of flags 0 or 1, got 1"),
    (
        "eli too short",
        put([1, 1, 0, 0], "eli"),
        "eli: expected 5 entries (one for each of 4 blocks and 1 balls), got 4",
    ),
    ("eli too long", put([0] * 25, "eli"), "eli: expected at most 24 entries, got a list of 25"),
    (
        "dynamic too long",
        put([0, 0, 0, 1, 1, 1], "dynamic"),
        "dynamic: expected 5 entries (one for each of 4 blocks and 1 balls), got 6",
    ),
    ("eli two", put(2, "eli", 1), "eli[1]: expected 0 or 1, got 2"),
    ("eli negative", put(-1, "eli", 1), "eli[1]: expected 0 or 1, got -1"),
    ("eli true", put(True, "eli", 1), "eli[1]: expected 0 or 1, got True"),
    ("dynamic a half", put(0.5, "dynamic", 3), "dynamic[3]: expected 0 or 1, got 0.5"),
    ("eliminable ball", put(1, "eli", 4), "eli[4]: expected 0 (object 4 is a ball, which cannot be eliminated), got 1"),
    ("static ball", put(0, "dynamic", 4), "dynamic[4]: expected 1 (object 4 is a ball, which always moves), got 0"),
    (
        "eliminable dynamic block",
        put(1, "eli", 3),
        "eli[3]: expected 0 (block 3 is dynamic; only a static one can be eliminated), got 1",
    ),
    ("seven eliminable", bars_and_balls(8, 1, 7), "eli: expected at most 6 eliminable blocks, got 7"),
    # pairs
    (
        "joint an object",
        put({}, "joint"),
        "joint: expected a list of pairs [object, object], got an object of 0 fields",
    ),
    ("joint unwrapped", put([2, 3], "joint"), "joint: expected a list of pairs [object, object], got a list of 2"),
    ("joint of three", put([[2, 3, 4]], "joint"), f"joint[0]: {NO_PAIR}a list of 3"),
    ("joint a half", put(2.5, "joint", 0, 0), "joint[0][0]: expected an object index (an integer), got 2.5"),
    ("joint true", put(True, "joint", 0, 0), "joint[0][0]: expected an object index (an integer), got True"),
    ("joint negative", put(-1, "joint", 0, 1), "joint[0][1]: expected an object index from 0 to 4, got -1"),
    ("spring out of range", put(5, "spring", 0, 1), "spring[0][1]: expected an object index from 0 to 4, got 5"),
    ("joint with itself", put([[3, 3]], "joint"), "joint[0]: expected two different objects, got 3 twice"),
    (
        "joint of static blocks",
        put([[0, 2]], "joint"),
        "joint[0]: expected at least one object that moves, got the static blocks 0 and 2",
    ),
    (
        "spring of static blocks",
        put([[3, 4], [1, 0]], "spring"),
        "spring[1]: expected at least one object that moves, got the static blocks 1 and 0",
    ),
    ("joint twice", put([[2, 3], [3, 2]], "joint"), "joint[1]: expected each pair once, got that of joint[0] again"),
    (
        "pin without length",
        pin_without_length,
        "joint[0]: expected two centres at least 0.001 px apart, got 0 px between 3 and 4",
    ),
    ("too many springs", put([[3, 4]] * 67, "spring"), "spring: expected at most 66 entries, got a list of 67"),
]


@pytest.mark.parametrize(("change", "line"), [pytest.param(c, m, id=i) for i, c, m in BAD])
def test_wrong_field_gets_its_line(change: Change, line: str, tmp_path: Path) -> None:
    scene = valid_scene()
    change(scene)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(scene))
    with pytest.raises(ValueError) as error:
        load_scene(path)
    assert str(error.value) == f"{path}: {line}"


def test_sixty_and_more_are_refused() -> None:
    assert len(BAD) >= 60
    assert len({line for _, _, line in BAD}) > 50  # and they differ


def test_the_unchanged_scene_is_sound() -> None:
    assert scene_from_dict(valid_scene()).eliminable_blocks == (0, 1)


def test_every_wrong_field_is_told() -> None:
    scene = valid_scene()
    scene["block"][0][0][0] = "x"
    scene["ball"][0][2] = None
    scene["eli"][2] = 3
    with pytest.raises(ValueError) as error:
        scene_from_dict(scene, "my scene")
    fields = [line.split(":")[:2] for line in str(error.value).split("\n")]
    assert fields == [["my scene", f" {field}"] for field in ("block[0][0][0]", "ball[0][2]", "eli[2]")]


def test_a_flood_of_wrong_fields_is_cut() -> None:
    scene = valid_scene() | {f"foreign {i}": 0 for i in range(1000)}
    with pytest.raises(ValueError) as error:
        scene_from_dict(scene)
    lines = str(error.value).split("\n")
    assert len(lines) == 21
    assert lines[-1] == "scene: and 980 more wrong fields"


BAD_FILES: list[tuple[str, bytes, str]] = [
    ("empty", b"", "expected JSON, got an error at line 1, column 1: Expecting value"),
    ("cut short", b'{"schema": ', "expected JSON, got an error at line 1, column 12: Expecting value"),
    ("not UTF-8", b'{"name": "\xff"}', "expected UTF-8 text, got another byte at offset 10"),
    ("UTF-16", "{}".encode("utf-16"), "expected UTF-8 text, got another byte at offset 0"),
    ("byte order mark", b"\xef\xbb\xbf{}", "expected UTF-8 text without a byte order mark"),
    ("key twice", b'{"name": "a", "name": "b"}', "'name': expected this field once, got it again"),
    ("nested deep", b"[" * 100_000, "expected JSON of a few levels, got too many nested in each other"),
    ("digits", b"1" * 5000, "expected numbers of ordinary length, got one of thousands of digits"),
    ("huge", b" " * 1_000_001, "expected at most 1000000 bytes, got more"),
    (
        "a list",
        b"[]",
        "expected an object with the fields schema, version, name, block, ball, eli, dynamic, joint, spring, limits,"
        " got a list of 0",
    ),
]


@pytest.mark.parametrize(("content", "line"), [pytest.param(c, m, id=i) for i, c, m in BAD_FILES])
def test_wrong_file_gets_its_line(content: bytes, line: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(ValueError) as error:
        load_scene(str(path))
    assert str(error.value) == f"{path}: {line}"


def test_infinity_literal_is_told_by_its_field(tmp_path: Path) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(valid_scene()).replace("250", "-Infinity"))
    with pytest.raises(ValueError) as error:
        load_scene(path)
    assert str(error.value) == f"{path}: ball[0][0]: {PX}-inf"


def test_missing_file(tmp_path: Path) -> None:
    path = tmp_path / "none.json"
    with pytest.raises(FileNotFoundError) as error:
        load_scene(path)
    assert str(error.value) == f"{path}: expected a scene file, but there is none"


def test_folder(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as error:
        load_scene(str(tmp_path))
    assert str(error.value) == f"{tmp_path}: expected a scene file, got a folder"


def test_device() -> None:
    with pytest.raises(OSError, match=r"^/dev/zero: expected a scene file, got a device, pipe or socket$"):
        load_scene("/dev/zero")


def test_name_too_long_for_a_file() -> None:
    with pytest.raises(OSError, match=r"expected a scene file that can be read, got: File name too long$"):
        load_scene("n" * 5000 + ".json")


def test_line_break_in_path_stays_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as error:
        load_scene(tmp_path / "a\nb.json")
    assert str(error.value) == f"{tmp_path}/a\\nb.json: expected a scene file, but there is none"


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("suport", "got 'suport' (did you mean support or support_hole or noisy_support?)"),
        ("???", "got '???' (iphyre_jax.GAMES lists them)"),
        ("", "got '' (iphyre_jax.GAMES lists them)"),
        ("a\0b", "got 'a\\x00b' (iphyre_jax.GAMES lists them)"),
    ],
)
def test_unknown_game(given: str, line: str) -> None:
    with pytest.raises(ValueError) as error:
        load_scene(given)
    assert str(error.value).startswith("scene: expected the name of a game or the path of a scene file, got ")
    assert str(error.value).endswith(line)


@pytest.mark.parametrize("given", [None, 3, b"support", ["support"], valid_scene()])
def test_not_a_scene_at_all(given: Any) -> None:
    with pytest.raises(
        ValueError, match=r"^scene: expected a game's name, the path of a scene file or a Scene, got "
    ) as error:
        load_scene(given)
    assert "\n" not in str(error.value)


def direct(**changes: object) -> dict[str, Any]:
    scene = {
        "name": "direct",
        "blocks": np.array([[[0.0, 0.0], [50.0, 0.0]]]),
        "balls": np.array([[25.0, -40.0, 20.0]]),
        "eliminable": np.array([True, False]),
        "dynamic": np.array([False, True]),
    }
    return scene | changes


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"blocks": np.full((1, 2, 2), np.nan)}, f"blocks[0][0][0]: {PX}nan"),
        ({"blocks": np.zeros((1, 4))}, f"blocks[0]: {NO_BAR}a list of 4"),
        (
            {"balls": np.zeros((0, 3)), "eliminable": [True], "dynamic": [False]},
            "balls: expected at least one ball, got none",
        ),
        ({"balls": 5.0}, "balls: expected a list of balls [x, y, radius], got 5.0"),
        (
            {"eliminable": np.array([True])},
            "eliminable: expected 2 entries (one for each of 1 blocks and 1 balls), got 1",
        ),
        ({"dynamic": np.array([0.5, 1.0])}, "dynamic[0]: expected 0 or 1, got 0.5"),
        ({"joints": ((0, 2),)}, "joints[0][1]: expected an object index from 0 to 1, got 2"),
        ({"springs": ((1, 1),)}, "springs[0]: expected two different objects, got 1 twice"),
    ],
)
def test_scene_built_directly_is_validated(changes: dict[str, object], line: str) -> None:
    with pytest.raises(ValueError) as error:
        Scene(**direct(**changes))
    assert str(error.value).split("\n")[0] == f"Scene 'direct': {line}"

"""Bad arguments of the command line."""

from __future__ import annotations

from tests.robustness.bad_arguments.given import (
    OUT,
    command,
    scene_file,
)
from tests.robustness.bad_arguments.kinds import (
    Row,
)

PAGE = OUT.with_suffix(".html")


def rows() -> list[Row]:
    """Return the rows of the command line."""
    plain, check = ("simulate", "hole"), ("scene", "check", scene_file())
    return [
        ("simulate", "fps", ("0", "-1", "1e3", "x", "9" * 400, "100000000"), lambda v: command(*plain, "--fps", v)),
        ("simulate", "resets", ("0", "-1", "x", "9" * 30), lambda v: command(*plain, "--resets", v)),
        ("simulate", "plan", ("x", "-1", "inf", "nan", "9" * 400), lambda v: command(*plain, "--plan", v)),
        ("simulate", "dtype", ("float16", ""), lambda v: command(*plain, "--dtype", v)),
        ("simulate", "rule", ("x", ""), lambda v: command(*plain, "--rule", v)),
        ("simulate", "scene", ("", "nonsense"), lambda v: command("simulate", v)),
        ("games", "split", ("nonsense", ""), lambda v: command("games", "--split", v)),
        (
            "scene check",
            "objects",
            ("0", "65", "-9"),
            lambda v: command(*check, "--max-objects", v),
        ),
        ("render", "size", ("0", "63", "9" * 30), lambda v: command("render", "basic", "-o", OUT, "--size", v)),
        ("render", "columns", ("0", "-1", "9" * 30), lambda v: command("render", "basic", "-o", OUT, "--columns", v)),
        ("render", "fade", ("-1", "nan", "inf", "1e300"), lambda v: command("render", "basic", "-o", OUT, "--fade", v)),
        ("render", "fps", ("0", "100000000"), lambda v: command("render", "hole", "-o", OUT, "--fps", v)),
        ("render", "game", ("nonsense",), lambda v: command("render", "best", "-o", OUT, "--game", v)),
        ("replay", "scene", (scene_file(),), lambda v: command("replay", v, "-o", PAGE)),
        ("replay", "game", ("hole",), lambda v: command("replay", v, "-o", PAGE)),
        ("replay", "games", ("nonsense",), lambda v: command("replay", "best", "--games", v, "-o", PAGE)),
        ("play", "port", ("-1", "65536", "9" * 30), lambda v: command("play", "--port", v)),
        ("play", "name", ("", "a\nb"), lambda v: command("play", "--name", v)),
        ("score", "plays", ("nonsense",), lambda v: command("score", v)),
        ("verify-pretrained", "name", ("nonsense", ""), lambda v: command("verify-pretrained", v)),
        ("train", "fps", ("0", "15", "9" * 30), lambda v: command("train", "--fps", v, "--out", OUT)),
        ("train", "seed", ("-1", "9" * 30), lambda v: command("train", "--seed", v, "--out", OUT)),
        ("train", "updates", ("0", "-1"), lambda v: command("train", "--updates", v, "--out", OUT)),
        ("train", "resets", ("0", "9" * 30), lambda v: command("train", "--resets", v, "--out", OUT)),
    ]

"""Bad arguments of the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from iphyre_jax.viewer import films, frames, load_plays, page, recording, sheets
from tests.robustness.bad_arguments.given import (
    hole,
    scene_file,
)
from tests.robustness.bad_arguments.kinds import (
    ARRAY,
    FLAG,
    HUGE,
    NAN,
    NUMBER,
    THING,
    WHOLE,
    WORD,
    Row,
    keywords,
)


def rows() -> list[Row]:
    """Return the rows of the viewer."""
    start, of_poses = sheets.start_of(hole()), recording.Recording.of_poses
    look: dict[str, Sequence[Any]] = {
        "theme": WORD,
        "size": (*WHOLE, 63, 2001),
        "fade": (*NUMBER, -1, 61),
        "trails": FLAG,
    }
    look |= {"trail_seconds": (*NUMBER, -1, 61), "captions": FLAG}
    return [
        ("record", "scene", THING, lambda v: recording.record(v, [-1])),
        ("record", "plan", (*ARRAY[:7], [-2], [0] * 9), lambda v: recording.record(hole(), v)),
        ("record", "fps", (*NUMBER, 0, 59.5, 10**8), lambda v: recording.record(hole(), [-1], fps=v)),
        ("record", "dtype", WORD, lambda v: recording.record(hole(), [-1], dtype=v)),
        ("record", "resets", (*WHOLE, 0, 10**12), lambda v: recording.record(hole(), [-1], resets=v)),
        (
            "Recording.of_poses",
            "poses",
            (None, "x", [[1]], [[[NAN] * 3]]),
            lambda v: of_poses(hole(), [-1], v),
        ),
        *keywords("Look", frames.Look, look),
        ("still", "plays", (None, 3, [], [1]), frames.still),
        ("still", "frame", (*WHOLE[:6], HUGE), lambda v: frames.still(start, frame=v)),
        ("frames", "every", (*WHOLE, 0), lambda v: next(frames.frames(start, every=v))),
        ("frames", "hold", (*NUMBER, -1, 1e9), lambda v: next(frames.frames(start, hold=v))),
        ("contact_sheet", "plays", (None, 3, [], [1]), sheets.contact_sheet),
        ("contact_sheet", "columns", (*WHOLE, 0, 401), lambda v: sheets.contact_sheet([start], columns=v)),
        ("contact_sheet", "look", (3, "dark"), lambda v: sheets.contact_sheet([start], look=v)),
        ("save", "a.txt", (None,), lambda v: films.save("a.txt", start)),
        ("load_plays", "source", (None, 3, "a\0b"), load_plays.load_plays),
        ("load_plays", "scene", (scene_file(),), load_plays.load_plays),
        ("replay_page", "plays", (None, [], 3), page.replay_page),
    ]

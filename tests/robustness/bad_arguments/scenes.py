"""Bad arguments of scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import iphyre_jax
from iphyre_jax import scenes
from tests.robustness.bad_arguments.given import (
    OUT,
    hole,
)
from tests.robustness.bad_arguments.kinds import (
    FLAG,
    HUGE,
    NAN,
    NUMBER,
    SCENE,
    THING,
    WHOLE,
    Row,
    keywords,
)


def rows() -> list[Row]:
    """Return the rows of scenes."""
    vary: dict[str, Sequence[Any]] = {
        "count": (*WHOLE, 0, 10**6 + 1, 10**9),
        "seed": (*WHOLE, 2**63),
        "mirrored": FLAG,
        "shift_px": (*NUMBER, -1, 1e308),
        "scale_by": (*NUMBER, 0.5, 1e308),
        "jitter_px": (*NUMBER, -1, 1e308),
        "extra_blocks": (*WHOLE, 50),
    }
    fields: dict[str, Sequence[Any]] = {
        "name": (None, 3, "", "a\nb", "x" * 10**6),
        "blocks": (None, 3, "x", [[[0, 0]]], [[[0, 0], [0, HUGE]]], np.zeros((10**6, 2, 2)), [[[5, 5], [5, 5]]]),
        "balls": (None, 3, [[0, 0]], [[0, 0, NAN]], [[0, 0, -1]], [[0, 0, 1e300]], np.zeros((10**6, 3))),
        "eliminable": (None, [2, 0], [0], np.zeros(10**7, bool)),
        "dynamic": (None, [0, 0], [NAN, 1], "01"),
        "joints": (None, 3, [[0, 0]], [[0, 9]], [[0]], [[0, HUGE]]),
        "limits": (None, 3, {}),
    }
    good = {"name": "a", "blocks": [[[0, 0], [9, 0]]], "balls": [[50, 50, 9]], "eliminable": [1, 0], "dynamic": [0, 1]}
    return [
        *keywords("vary", lambda **k: iphyre_jax.vary(hole(), **({"count": 1} | k)), vary),
        ("vary", "scene", THING, lambda v: iphyre_jax.vary(v, 1)),
        *keywords("Scene", lambda **k: iphyre_jax.Scene(**(good | k)), fields),
        *keywords("Limits", iphyre_jax.Limits, {"objects": (*WHOLE, 11, 65), "blocks": (*WHOLE, 5, 65)}),
        ("SceneBuilder.joint", "first", THING, lambda v: scenes.SceneBuilder("a").joint(v, v)),
        ("SceneBuilder.spring", "first", THING, lambda v: scenes.SceneBuilder("a").spring(v, v)),
        ("SceneBuilder", "limits", THING, lambda v: scenes.SceneBuilder("a", v)),
        ("SceneBuilder.ball", "centre", (None, 3, "xy", [1]), lambda v: scenes.SceneBuilder("a").ball(v)),
        ("SceneBuilder.block", "dynamic", FLAG, lambda v: scenes.SceneBuilder("a").block((0, 0), (9, 9), dynamic=v)),
        ("load_scene", "scene", SCENE, iphyre_jax.load_scene),
        ("load_scene", "limits", (3, "x", {}), lambda v: iphyre_jax.load_scene("hole", v)),
        ("load_scenes", "scenes", (None, 3, "hole", [], {}), scenes.load_scenes),
        ("scene_to_dict", "scene", THING, scenes.scene_to_dict),
        ("scene_from_dict", "scene", (None, 3, [], {}, "x"), scenes.scene_from_dict),
        ("write_scene", "scene", THING, lambda v: scenes.write_scene(v, OUT)),
    ]

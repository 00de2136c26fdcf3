"""A chunk of scenes: draw them, refuse, play, keep. A function of the settings and the chunk's number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.generated.canvas import Canvas, Ints
from iphyre_jax.data.generated.distance import NEAREST, distances_to_test_games
from iphyre_jax.data.generated.drawing import CHUNK, KINDS, STREAM, draw_chunk
from iphyre_jax.data.generated.filtering import DTYPE, KEPT, NEAR, NO_ROOM, Compiled, grade_scenes
from iphyre_jax.data.generated.pool import GeneratorSettings, scene_columns, scene_name
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene

Arrays = Mapping[str, npt.NDArray[Any]]


class _Drawn(NamedTuple):
    """A chunk before it is played."""

    canvas: Canvas
    basic: Ints  # (CHUNK,) the basic game that a scene began with, -1 for none
    distance: npt.NDArray[np.float64]  # (CHUNK,) px to the nearest test game
    reason: npt.NDArray[np.int8]  # (CHUNK,) why it is not played; KEPT if it is
    scenes: list[Scene]  # those to play
    worlds: list[Compiled]


def make_chunk(settings: GeneratorSettings, chunk: int) -> Arrays:
    """Return the kept scenes of a chunk as arrays, and the reasons of all.

    Args:
        settings: of the scenes.
        chunk: its number; it holds the scenes from chunk x CHUNK.
    """
    return _play(_draw(settings, chunk), settings, chunk)


def _draw(settings: GeneratorSettings, chunk: int) -> _Drawn:
    """Draw a chunk and compile the scenes that are to be played."""
    canvas, whole, basic = draw_chunk(settings.seed, chunk, settings.kind)
    reason, distance = np.full(CHUNK, NO_ROOM, np.int8), np.full(CHUNK, np.inf)
    distance[whole] = distances_to_test_games(canvas.take(whole))
    reason[whole] = np.where(distance[whole] < NEAREST, NEAR, KEPT)
    rows = np.flatnonzero(reason == KEPT).tolist()
    scenes = [canvas.scene(row, scene_name(settings.kind, settings.seed, chunk * CHUNK + row)) for row in rows]
    worlds = [compile_scene(scene, resets=settings.protocol.resets, dtype=DTYPE) for scene in scenes]
    return _Drawn(canvas, basic, distance, reason, scenes, worlds)


def _play(drawn: _Drawn, settings: GeneratorSettings, chunk: int) -> Arrays:
    """Return the kept scenes of a chunk as arrays, and the reasons of all."""
    lots = np.random.default_rng([settings.seed, STREAM + 1, chunk]).random(CHUNK)
    rows, reason = np.flatnonzero(drawn.reason == KEPT), drawn.reason.copy()
    idle_share = KINDS[settings.kind].idle_share
    grades = grade_scenes(drawn.scenes, drawn.worlds, settings.protocol, lots[rows], idle_share)
    reason[rows] = grades.reason
    taken = grades.reason == KEPT
    kept = rows[taken]
    return {
        "number": chunk * CHUNK + kept,
        "basic": drawn.basic[kept].astype(np.int8),
        "distance": drawn.distance[kept],
        "plans": grades.plans[taken],
        "solved": grades.solved[taken],
        **scene_columns(drawn.canvas.take(kept)),
        "reason": reason,
    }

"""`generate_scenes`: draw scenes in chunks, refuse, play, keep, until there are enough."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import MAX_SEED, check_whole
from iphyre_jax.data.generated.canvas import Canvas, Ints
from iphyre_jax.data.generated.distance import NEAREST, distances_to_test_games
from iphyre_jax.data.generated.drawing import CHUNK, STREAM, draw_chunk
from iphyre_jax.data.generated.filtering import DTYPE, KEPT, NEAR, NO_ROOM, Compiled, grade_scenes
from iphyre_jax.data.generated.pool import GeneratedScenes, scene_columns, scene_name
from iphyre_jax.data.journal import Journal, journal_in
from iphyre_jax.envs.protocols import EpisodeProtocol, protocol_named
from iphyre_jax.memory import check_memory
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene

RECIPE: Final = 1  # a higher number for other scenes of the same seed
MOST: Final = 1_000_000  # scenes of a call
BYTES_OF_SCENE: Final = 10_000  # of a Scene and of its numbers in arrays

Arrays = Mapping[str, npt.NDArray[Any]]


class _Drawn(NamedTuple):
    """A chunk before it is played."""

    canvas: Canvas
    basic: Ints  # (CHUNK,) the basic game that a scene began with, -1 for none
    distance: npt.NDArray[np.float64]  # (CHUNK,) px to the nearest test game
    reason: npt.NDArray[np.int8]  # (CHUNK,) why it is not played; KEPT if it is
    scenes: list[Scene]  # those to play
    worlds: list[Compiled]


def generate_scenes(
    count: int,
    seed: int = 0,
    *,
    protocol: str = "official",
    journal: str | os.PathLike[str] | None = None,
    report: Callable[[str], None] | None = None,
) -> GeneratedScenes:
    """Generate scenes of the elements of the ten basic games.

    Doing nothing fails in each, one of 160 random plans solves it, and at most 0.6 of the random plans do. None is near
    a game of the splits noisy, compositional, multi_ball or unseen_basic. The same arguments give the same scenes; more
    scenes of a seed begin with the fewer.

    Args:
        count: scenes to keep, 1 to 1,000,000.
        seed: of the scenes, 0 to 2**63 - 1.
        protocol: rate and reset at which plans are played: "official", 10 steps a second after the second reset, or
            "smooth", 60 in a fresh space.
        journal: folder that keeps what is done, so that a call which was killed goes on; removed at the end.
        report: called with a line of progress after each chunk.

    Returns:
        The scenes with their grades and counts.

    Raises:
        ValueError: an argument is wrong, or memory does not suffice; one line.
        BlockingIOError: another process uses the journal; one line.
        OSError: the journal cannot be written.
    """
    check_whole("count", count, 1, MOST)
    check_whole("seed", seed, 0, MAX_SEED)
    rates = protocol_named(protocol)
    check_memory("count", count * BYTES_OF_SCENE, "generate fewer at a time, with other seeds")
    chunks: list[Arrays] = []
    kept, start = 0, time.monotonic()
    with journal_in(journal, report) as notes:
        for chunk in _chunks(seed, rates, notes):
            chunks.append(chunk)
            kept += len(chunk["number"])
            drawn, seconds = len(chunks) * CHUNK, time.monotonic() - start
            notes.report(f"{min(kept, count)} of {count} kept, {drawn} drawn, {kept / seconds:.0f} kept a second")
            if kept >= count:
                break
    return GeneratedScenes.of_chunks(chunks, count, seed, rates)


def _chunks(seed: int, protocol: EpisodeProtocol, journal: Journal) -> Iterator[Arrays]:
    """Yield the kept scenes of all chunks; the next chunk is drawn while one is played."""
    ahead: dict[int, Future[_Drawn]] = {}
    with ThreadPoolExecutor(1, thread_name_prefix="iphyre_jax drawing") as helper:
        try:
            for chunk in range(2**31):

                def work(chunk: int = chunk) -> Arrays:
                    given = ahead.pop(chunk, None)
                    drawn = _draw(seed, chunk, protocol) if given is None else given.result()
                    ahead[chunk + 1] = helper.submit(_draw, seed, chunk + 1, protocol)
                    return _play(drawn, seed, chunk, protocol)

                settings = {"generated": RECIPE, "seed": seed, "chunk": chunk, **vars(protocol)}
                yield journal.entry(settings, {}, work)
        finally:
            for waiting in ahead.values():
                waiting.cancel()


def _draw(seed: int, chunk: int, protocol: EpisodeProtocol) -> _Drawn:
    """Draw a chunk and compile the scenes that are to be played."""
    canvas, whole, basic = draw_chunk(seed, chunk)
    reason, distance = np.full(CHUNK, NO_ROOM, np.int8), np.full(CHUNK, np.inf)
    distance[whole] = distances_to_test_games(canvas.take(whole))
    reason[whole] = np.where(distance[whole] < NEAREST, NEAR, KEPT)
    rows = np.flatnonzero(reason == KEPT).tolist()
    scenes = [canvas.scene(row, scene_name(seed, chunk * CHUNK + row)) for row in rows]
    worlds = [compile_scene(scene, resets=protocol.resets, dtype=DTYPE) for scene in scenes]
    return _Drawn(canvas, basic, distance, reason, scenes, worlds)


def _play(drawn: _Drawn, seed: int, chunk: int, protocol: EpisodeProtocol) -> Arrays:
    """Return the kept scenes of a chunk as arrays, and the reasons of all."""
    lots = np.random.default_rng([seed, STREAM + 1, chunk]).random(CHUNK)
    rows, reason = np.flatnonzero(drawn.reason == KEPT), drawn.reason.copy()
    grades = grade_scenes(drawn.scenes, drawn.worlds, protocol, lots[rows])
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

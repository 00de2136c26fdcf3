"""`generate_scenes`: draw scenes in chunks, refuse, play, keep, until there are enough."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import Final

from iphyre_jax.checks import MAX_SEED, check_option, check_whole
from iphyre_jax.data.generated.chunks import Arrays
from iphyre_jax.data.generated.drawing import CHUNK, DEFAULT_KIND, KINDS, SceneKind
from iphyre_jax.data.generated.pool import GeneratedScenes, GeneratorSettings
from iphyre_jax.data.generated.workers import all_chunks
from iphyre_jax.data.journal import Journal, journal_in
from iphyre_jax.envs.protocols import protocol_named
from iphyre_jax.memory import check_memory

RECIPE: Final = 1  # a higher number for other scenes of the same seed
MOST: Final = 1_000_000  # scenes of a call
BYTES_OF_SCENE: Final = 10_000  # of a Scene and of its numbers in arrays


def generate_scenes(
    count: int,
    seed: int = 0,
    *,
    protocol: str = "official",
    kind: SceneKind = DEFAULT_KIND,
    journal: str | os.PathLike[str] | None = None,
    report: Callable[[str], None] | None = None,
    save: Callable[[GeneratedScenes], object] | None = None,
) -> GeneratedScenes:
    """Generate scenes of the ten basic games' elements, or of two basic games each.

    Doing nothing fails in each, one of 160 random plans solves it, and at most 0.6 of the random plans do; but some
    unions solve themselves. None is near a game of the splits noisy, compositional, multi_ball or unseen_basic. The
    same arguments give the same scenes; more scenes of a seed begin with the fewer.

    Args:
        count: scenes to keep, 1 to 1,000,000.
        seed: of the scenes, 0 to 2**63 - 1.
        protocol: rate and reset at which plans are played: "official", 10 steps a second after the second reset, or
            "smooth", 60 in a fresh space.
        kind: "elements", compositions of elements and basic games that are moved about; or "unions", the objects of two
            basic games, some bars of each left out.
        journal: folder that keeps what is done, so that a call which was killed goes on; removed at the end.
        report: called with a line of progress after each chunk.
        save: called with the scenes before the journal goes, so that a kill between the two loses nothing.

    Returns:
        The scenes with their grades and counts.

    Raises:
        ValueError: an argument is wrong, or memory does not suffice; one line.
        BlockingIOError: another process uses the journal; one line.
        OSError: the journal cannot be written.
    """
    count = check_whole("count", count, 1, MOST)
    seed = check_whole("seed", seed, 0, MAX_SEED)
    check_option("kind", kind, tuple(KINDS))
    settings = GeneratorSettings(seed, protocol_named(protocol), kind)
    check_memory("count", count * BYTES_OF_SCENE, "generate fewer at a time, with other seeds")
    chunks: list[Arrays] = []
    kept, start = 0, time.monotonic()
    with journal_in(journal, report) as notes:
        with closing(all_chunks(settings, partial(_entry, notes, settings))) as given:
            for chunk in given:
                chunks.append(chunk)
                kept += len(chunk["number"])
                drawn, seconds = len(chunks) * CHUNK, time.monotonic() - start
                notes.report(f"{min(kept, count)} of {count} kept, {drawn} drawn, {kept / seconds:.0f} kept a second")
                if kept >= count:
                    break
        scenes = GeneratedScenes.of_chunks(chunks, count, settings)
        if save is not None:
            save(scenes)
    return scenes


def _entry(journal: Journal, settings: GeneratorSettings, number: int, work: Callable[[], Arrays]) -> Arrays:
    """Return a chunk from the journal if it is there, else work it out and keep it there."""
    of = {"seed": settings.seed, "kind": settings.kind, "chunk": number, **vars(settings.protocol)}
    return journal.entry({"generated": RECIPE, **of}, {}, work)

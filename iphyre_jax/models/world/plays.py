"""Plays that world models learn from: places and speeds of what moves, every 0.1 s, of basic games and variations.

An instant is 0.1 s after the last one and begins one physics step after a tenth of a second: there most removals of the
rule "simulate" fall. Speeds are differences of places one physics step apart, so what the solver calls the velocity.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.agents import random_plans
from iphyre_jax.models.world.settings import DataName
from iphyre_jax.models.world.tables import Floats, Plays, SceneTables, scene_tables
from iphyre_jax.physics.constants import GRAVITY
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES, NEVER, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE, MAX_OBJECTS, SPLITS, Scene, load_scene
from iphyre_jax.simulation import simulate_many
from iphyre_jax.train.scenes import variations

FPS: Final = 60
EVERY: Final = FPS // DECISIONS_PER_SECOND  # physics steps between two instants
FIRST: Final = 1  # physics steps before the first instant
INSTANTS: Final = FRAMES  # 0, 1, ..., 149
STAYS: Final = 10_000  # instant at which a block goes that never does
BLOCK: Final = 400  # plays at a time: their samples take 40 MB
VARIED: Final = 60  # variations of each game that a chunk of new plays takes its scenes from
POOL: Final = 400  # variations of each game in all
CHUNK: Final = 1000  # new plays of a chunk
STREAM: Final = 15_485_863  # seeds of variations and plans: not those of other trainings
MOVING: Final = 5.0  # px/s, from which on a body counts as moving
FAST: Final = 1.0  # px/s, of all windows in which something is at least so fast


def instants(steps: npt.NDArray[np.integer[Any]]) -> npt.NDArray[np.int32]:
    """The first instants at which a removal before a physics step shows; STAYS for never."""
    at = -(-(np.maximum(steps, FIRST) - FIRST) // EVERY)
    return np.where(steps == NEVER, STAYS, at).astype(np.int32)


def removal_instants(scenes: Sequence[Scene], which: npt.ArrayLike, steps: npt.ArrayLike) -> npt.NDArray[np.int32]:
    """Instants from which on each object is gone, (N, 12); which: (N,), steps: (N, S)."""
    index, plan = np.asarray(which), np.asarray(steps)
    gone = np.full((len(index), MAX_OBJECTS), STAYS, np.int32)
    for number, scene in enumerate(scenes):
        rows = np.flatnonzero(index == number)
        for slot, block in enumerate(scene.eliminable_blocks):
            gone[rows, block] = instants(plan[rows, slot])
    return gone


def play(scenes: Sequence[Scene], which: npt.ArrayLike, steps: npt.ArrayLike, movers: int = 0, ties: int = 0) -> Plays:
    """Play plans (N, S), in physics steps, and keep what moves.

    Args:
        scenes: S scenes.
        which: (N,) the scene of each plan.
        steps: see `simulate_many`; 60 steps a second, float32, fresh space.
        movers: room for moving bodies.
        ties: room for ties.
    """
    tables = scene_tables(scenes, movers, ties)
    index, plan = np.asarray(which, np.int32), np.asarray(steps)
    parts = [
        _block(scenes, tables, index[at : at + BLOCK], plan[at : at + BLOCK]) for at in range(0, len(index), BLOCK)
    ]
    state, success, end = (np.concatenate(part) for part in zip(*parts, strict=True))
    # Speeds need one more physics step, and the last step's pose repeats after the end.
    valid = np.clip((end - FIRST - 1) // EVERY + 1, 0, INSTANTS).astype(np.int32)
    return Plays(tables, index, state, valid, removal_instants(scenes, index, plan), success, end)


def _block(
    scenes: Sequence[Scene], tables: SceneTables, which: npt.NDArray[np.int32], plan: npt.NDArray[Any]
) -> tuple[Floats, npt.NDArray[np.bool_], npt.NDArray[np.int32]]:
    played = simulate_many(scenes, which, plan, fps=FPS, duration=TIME_LIMIT, sample_every=1)
    if played.samples is None:
        raise RuntimeError("simulate_many gave no samples")
    first = played.samples[:, FIRST : FIRST + EVERY * INSTANTS : EVERY]
    second = played.samples[:, FIRST + 1 : FIRST + 1 + EVERY * INSTANTS : EVERY]
    mover = np.asarray(tables.mover)[which]
    take = np.broadcast_to(mover[:, None, :, None], (len(which), INSTANTS, mover.shape[1], 3))
    pose, later = (np.take_along_axis(part, take, axis=2) for part in (first, second))
    state = np.concatenate([pose, (later - pose) * FPS], axis=-1)
    state = np.where(np.asarray(tables.moves)[which][:, None, :, None], np.nan_to_num(state), 0.0)
    return state.astype(np.float32), played.success, played.steps.astype(np.int32)


def draw_steps(scenes: Sequence[Scene], which: npt.NDArray[Any], rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Plans of the official distribution, (N, 6), in physics steps; removals fall on instants exactly."""
    plans = np.full((len(which), MAX_ELIMINABLE), NEVER, np.int64)
    for row, index in enumerate(which):
        count = len(scenes[int(index)].eliminable_blocks)
        times = random_plans(rng, count, 1)[0]
        tenths = np.rint(np.nan_to_num(times) * DECISIONS_PER_SECOND).astype(np.int64)
        plans[row, :count] = np.where(np.isnan(times), NEVER, EVERY * tenths + FIRST)
    return plans


def basic_plays(count: int, seed: int) -> Plays:
    """Plays of the ten basic games with random plans, the same number of each."""
    scenes = [load_scene(name) for name in SPLITS["basic"]]
    which = np.resize(np.arange(len(scenes)), count)
    return play(scenes, which, draw_steps(scenes, which, np.random.default_rng([STREAM, seed])))


@lru_cache(16)
def _pool(game: str) -> tuple[Scene, ...]:
    return variations(game, POOL, STREAM, 0)


def varied_plays(seed: int, chunk: int) -> Plays:
    """The new plays of a chunk: one in five of a basic game, the others of variations of them."""
    rng = np.random.default_rng([STREAM, seed, chunk + 1])
    scenes = [load_scene(name) for name in SPLITS["basic"]]
    for name in SPLITS["basic"]:
        pool = _pool(name)
        scenes += [pool[int(index)] for index in rng.choice(len(pool), VARIED, replace=False)]
    own = rng.random(CHUNK) < 0.2
    which = np.where(own, rng.integers(10, size=CHUNK), rng.integers(10, len(scenes), size=CHUNK))
    return play(scenes, which, draw_steps(scenes, which, rng))


def learned_plays(data: DataName, seed: int, chunk: int) -> Plays:
    """What a run learns from in a chunk of its training."""
    return varied_plays(seed, chunk) if data == "unlimited" else basic_plays(int(data), seed)


def official_plays(games: Sequence[str], each: int, seed: int, movers: int = 0, ties: int = 0) -> Plays:
    """Plays of games with `each` plans of the official distribution and the steps of the rule "simulate".

    Some of their removals fall one physics step before an instant.
    """
    scenes = [load_scene(name) for name in games]
    which = np.repeat(np.arange(len(scenes)), each)
    times = np.full((len(which), MAX_ELIMINABLE), np.nan)
    for row, index in enumerate(which):
        count = len(scenes[index].eliminable_blocks)
        rng = np.random.default_rng([STREAM, seed, row % each, *scenes[index].name.encode()])
        times[row, :count] = random_plans(rng, count, 1)[0]
    return play(scenes, which, plan_to_steps(times, FPS, "simulate"), movers, ties)


def windows(plays: Plays, length: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64]]:
    """Beginnings (W, 2), play and instant, of windows of `length` + 1 instants, and their weights.

    Windows in which all rests are rare; those in which something does not fall freely are frequent.
    """
    size = np.abs(np.asarray(plays.state)[..., 3:5]).max(axis=-1)  # (N, 150, M)
    velocity = np.asarray(plays.state)[..., 3:5]
    change = velocity[:, 1:] - velocity[:, :-1] - np.array([0.0, GRAVITY / DECISIONS_PER_SECOND], np.float32)
    pushed = (np.abs(change).max(axis=-1) > FAST) & (size[:, :-1] > FAST)
    weight = np.where(size[:, :-1].max(axis=-1) > FAST, 0.3, 0.05) + 1.0 * pushed.any(axis=-1)
    reached = np.arange(INSTANTS - length)[None] + length < np.asarray(plays.valid)[:, None]
    play_index, instant = np.nonzero(reached)
    return np.stack([play_index, instant], axis=1).astype(np.int32), weight[play_index, instant]

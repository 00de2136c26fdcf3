"""Which drawn scenes are kept: doing nothing fails, random plans find a solution, and not nearly every plan does.

Every scene plays the same stream of random plans, the official one of the data sets, in rounds. A scene leaves as soon
as its grade is clear, so that hard scenes alone play many plans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import islice
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.compat.actions import draw_plans
from iphyre_jax.data.draws import INTERVAL, LAST_TIME, STAYS
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.execution.devices import partition_of
from iphyre_jax.execution.plan_batch import PlanBatch, Settings
from iphyre_jax.physics.types import Topology, World
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import NEVER
from iphyre_jax.scenes import MAX_ELIMINABLE, Scene

DTYPE: Final = "float32"
ROUNDS: Final = ((24, 1), (96, 0), (160, 0))  # plans after each round, and how many may solve a scene that goes on
EASIEST: Final = 0.6  # share of random plans that solve a scene which is kept, at most
GRADES: Final = (0.04, 0.15, 0.35)  # shares of plans: where the next grade begins
CHOSEN: Final = (1.0, 0.65, 0.28, 0.2)  # share of each grade that is kept, so that a quarter is hard
PLAN_SEED: Final = 1_017  # of the random plans

KEPT, NO_ROOM, NEAR, IDLE, EASY, NOT_CHOSEN, UNSOLVED, CONTACTS = range(8)
REASONS: Final = (
    "kept",
    "no room for an element",
    "near a test game",
    "solves itself",
    "too easy",
    "of a frequent grade, not chosen",
    "no plan solves it",
    "more contacts than a game has",
)

Ints = npt.NDArray[np.integer[Any]]
Compiled = tuple[Topology, World]


@dataclass(frozen=True)
class Grades:
    """What became of n scenes: the reason, a number of REASONS; plans played; plans that solve; each (n,)."""

    reason: npt.NDArray[np.int8]
    plans: npt.NDArray[np.int16]
    solved: npt.NDArray[np.int16]


@cache
def plan_stream(blocks: int) -> npt.NDArray[np.int64]:
    """Return the random plans of scenes with so many eliminable blocks, (160, 6) tenths of a second, -1 for never."""
    instants = list(np.arange(0, LAST_TIME["official"], INTERVAL))
    drawn = islice(draw_plans(instants, blocks, MAX_ELIMINABLE, PLAN_SEED, STAYS), ROUNDS[-1][0])
    return plan_to_steps(np.array(list(drawn)), 10, "in_advance")


def grade_scenes(
    scenes: Sequence[Scene],
    worlds: Sequence[Compiled],
    protocol: EpisodeProtocol,
    lots: npt.NDArray[np.float64],
    idle_share: float = 0.0,
) -> Grades:
    """Play random plans of scenes and decide which are kept.

    Args:
        scenes: n scenes.
        worlds: of the scenes, at the protocol's reset, in float32.
        protocol: rate and reset.
        lots: (n,) from 0 to 1; they decide which scenes of a frequent grade are chosen.
        idle_share: of the scenes that solve themselves, the share that is kept, whatever their grade.
    """
    count, first = len(scenes), 0
    reason, plans, solved = (np.full(count, value, int) for value in (UNSOLVED, 0, 0))
    idle = _idle(scenes, worlds, protocol)
    kept_idle = idle & (lots < idle_share)
    reason[idle & ~kept_idle] = IDLE
    rows = np.flatnonzero(reason == UNSOLVED)
    for last, most in ROUNDS:
        success, fault = _play(scenes, worlds, rows, (first, last), protocol)
        plans[rows], solved[rows] = last, solved[rows] + success
        reason[rows[fault]] = CONTACTS
        rows = rows[(solved[rows] <= most) & ~fault]
        first = last
    _judge(reason, plans, solved, lots)
    reason[kept_idle & (reason != CONTACTS)] = KEPT
    return Grades(reason.astype(np.int8), plans.astype(np.int16), solved.astype(np.int16))


def _judge(reason: Ints, plans: Ints, solved: Ints, lots: npt.NDArray[np.float64]) -> None:
    """Write the reasons of those that neither solve themselves nor lack contact slots."""
    share = solved / np.maximum(plans, 1)
    open_ones = (reason == UNSOLVED) & (solved > 0)
    chosen = lots < np.array(CHOSEN)[np.searchsorted(GRADES, share, side="right")]
    reason[open_ones] = np.where(share > EASIEST, EASY, np.where(chosen, KEPT, NOT_CHOSEN))[open_ones]


def _idle(scenes: Sequence[Scene], worlds: Sequence[Compiled], protocol: EpisodeProtocol) -> npt.NDArray[np.bool_]:
    """Return whether each scene is solved if nothing is removed, (n,)."""
    never = np.full((len(scenes), MAX_ELIMINABLE), NEVER)
    return _run(scenes, worlds, np.arange(len(scenes)), never, protocol).success


def _play(
    scenes: Sequence[Scene], worlds: Sequence[Compiled], rows: Ints, which: tuple[int, int], protocol: EpisodeProtocol
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Play a part of the stream of plans; return for each scene how many solve it, and whether one lacks slots."""
    first, last = which
    if not len(rows):
        return np.zeros(0, np.int64), np.zeros(0, bool)
    streams = [plan_stream(len(scenes[row].eliminable_blocks))[first:last] for row in rows.tolist()]
    steps = np.concatenate(streams)
    steps = np.where(steps == NEVER, NEVER, steps * protocol.steps_per_frame)
    played = _run(scenes, worlds, np.repeat(rows, last - first), steps, protocol)
    shape = (len(rows), last - first)
    return played.success.reshape(shape).sum(axis=1), np.asarray((played.fault.reshape(shape) > 0).any(axis=1))


def _run(
    scenes: Sequence[Scene],
    worlds: Sequence[Compiled],
    which: Ints,
    steps: Ints,
    protocol: EpisodeProtocol,
) -> PlanBatch:
    """Play plans once: who lacks contact slots is not played again with more, so that few programs are compiled."""
    settings = Settings(float(protocol.fps), protocol.steps, DTYPE, protocol.resets, None)
    batch = PlanBatch(
        list(scenes), list(worlds), which.astype(np.int64), steps.astype(np.int32), settings, partition_of(None)
    )
    batch.run(np.arange(len(which)), attempt=0)
    return batch

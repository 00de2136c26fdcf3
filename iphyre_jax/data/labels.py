"""Labels: how plans end, always decided in float64, for in float32 one plan in 200 ends at another step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from iphyre_jax.data.arrays import frames_of
from iphyre_jax.data.dataset import scene_sum
from iphyre_jax.data.journal import Journal
from iphyre_jax.execution.devices import partition_of
from iphyre_jax.execution.plan_batch import PlanBatch, Settings
from iphyre_jax.plans import Rule, plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND, FRAMES, OFFICIAL_FPS, OFFICIAL_RESETS
from iphyre_jax.scenes import Scene
from iphyre_jax.scenes.compile import compile_scene
from iphyre_jax.simulation import simulate_many

DTYPE: Final = "float64"
FRESH: Final = 1  # resets: every play in a space of its own
FIRST_RESET: Final = 2  # of the official loop: it resets its space when it makes it, and before each plan
MOST_PLANS: Final = 16_384  # in one call, and in one entry of the journal
MOST_WORLDS: Final = 2_048  # the same, if each plan has a reset of its own, hence a world of its own
MOST_SEQUENCES: Final = 512  # the same with poses

Ints = npt.NDArray[np.integer[Any]]
Poses = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Labels:
    """How B plays ended."""

    success: npt.NDArray[np.bool_]
    end_step: npt.NDArray[np.int16]  # steps made, the solving one included
    removals: npt.NDArray[np.int8]  # executed
    fault: npt.NDArray[np.int8]  # 0 for a sound world

    def take(self, rows: npt.NDArray[Any]) -> Labels:
        """Return some of the plays; rows: indices or a mask."""
        return Labels(*(getattr(self, column.name)[rows] for column in fields(self)))

    def columns(self, draw: Ints) -> dict[str, npt.NDArray[Any]]:
        """Return the columns of a `Dataset` that these are, with the number of each draw."""
        return {"success": self.success, "end_step": self.end_step, "removals": self.removals, "draw": draw}

    @classmethod
    def join(cls, parts: Sequence[Labels]) -> Labels:
        """Return the plays of all parts in turn."""
        empty = cls(np.zeros(0, bool), np.zeros(0, np.int16), np.zeros(0, np.int8), np.zeros(0, np.int8))
        return cls(
            *(np.concatenate([getattr(part, column.name) for part in (empty, *parts)]) for column in fields(cls))
        )


@dataclass(frozen=True)
class PlayProtocol:
    """How plans become plays: rate, rule and reset."""

    fps: int = 60
    rule: Rule = "simulate"
    resets: int = FRESH

    @classmethod
    def at(cls, fps: int) -> Self:
        """As people play at a rate; at the rate of the official environments, as in them."""
        return cls(fps, "in_advance", OFFICIAL_RESETS) if fps == OFFICIAL_FPS else cls(fps)

    @property
    def frames(self) -> int:
        """The steps of a whole play."""
        return frames_of(self.fps, self.rule)

    def steps(self, times: npt.NDArray[np.floating[Any]]) -> npt.NDArray[np.int64]:
        """Return the steps of plans, (B, S); a time of 0 is an entry that removes nothing."""
        return plan_to_steps(times, self.fps, self.rule)


def label_plans(
    scenes: Sequence[Scene],
    game: Ints,
    steps: Ints,
    protocol: PlayProtocol,
    resets: Ints | None = None,
    journal: Journal | None = None,
) -> Labels:
    """Play B plans on all cores.

    Args:
        scenes: what is played.
        game: (B,) index of each plan's scene.
        steps: (B, S) the step before which each block goes, -1 for never.
        protocol: how.
        resets: (B,) number of the reset of each play, instead of that of the protocol.
        journal: keeps what is done.
    """
    size = MOST_PLANS if resets is None else MOST_WORLDS
    parts = [slice(first, first + size) for first in range(0, len(game), size)]
    own = [None if resets is None else resets[part] for part in parts]
    played = [
        _play(scenes, game[part], steps[part], protocol, reset, None, journal or Journal())
        for part, reset in zip(parts, own, strict=True)
    ]
    return Labels.join([Labels(*(arrays[column.name] for column in fields(Labels))) for arrays in played])


def play_poses(
    scenes: Sequence[Scene],
    game: Ints,
    steps: Ints,
    protocol: PlayProtocol,
    resets: Ints | None = None,
    journal: Journal | None = None,
) -> Poses:
    """Play B plans and return the poses of what moves, (B, 150, M, 3); see `Dataset.poses`. Arguments as above.

    M is the largest number of movers of `scenes`.
    """
    parts = [slice(first, first + MOST_SEQUENCES) for first in range(0, len(game), MOST_SEQUENCES)]
    own = [None if resets is None else resets[part] for part in parts]
    every = protocol.fps // DECISIONS_PER_SECOND
    movers = max(int(scene.dynamic.sum()) for scene in scenes)
    poses = np.full((len(game), FRAMES, movers, 3), np.nan)
    for part, reset in zip(parts, own, strict=True):
        played = _play(scenes, game[part], steps[part], protocol, reset, every, journal or Journal())["poses"]
        poses[part, :, : played.shape[2]] = played
    return poses


def _play(
    scenes: Sequence[Scene],
    game: Ints,
    steps: Ints,
    protocol: PlayProtocol,
    resets: Ints | None,
    every: int | None,
    journal: Journal,
) -> dict[str, npt.NDArray[Any]]:
    """Play one part, or find it in the journal."""
    which = sorted(set(game.tolist()))
    settings = {
        **vars(protocol),
        "frames": protocol.frames,
        "every": every,
        "scenes": [scene_sum(scenes[k]) for k in which],
    }
    inputs: dict[str, npt.NDArray[Any]] = {"game": np.searchsorted(which, game), "steps": steps.astype(np.int32)}
    if resets is not None:
        inputs["resets"] = resets.astype(np.int64)
    own = [scenes[k] for k in which]

    def work() -> dict[str, npt.NDArray[Any]]:
        columns, samples = _simulate(own, inputs["game"], inputs["steps"], protocol, resets, every)
        named = dict(zip([column.name for column in fields(Labels)], columns, strict=True))
        return named if samples is None else {**named, "poses": _movers(own, inputs["game"], samples)}

    return dict(journal.entry(settings, inputs, work))


def _simulate(
    scenes: Sequence[Scene], game: Ints, steps: Ints, protocol: PlayProtocol, resets: Ints | None, every: int | None
) -> tuple[list[npt.NDArray[Any]], npt.NDArray[Any] | None]:
    """Return success, end step, removals and fault of each play, and its samples, if any."""
    if resets is None:
        seconds = protocol.frames / protocol.fps
        played: Any = simulate_many(
            scenes,
            game,
            steps,
            fps=protocol.fps,
            duration=seconds,
            dtype=DTYPE,
            resets=protocol.resets,
            sample_every=every,
        )
    else:  # a world for each play: no two have the same reset
        worlds = [compile_scene(scenes[k], resets=r, dtype=DTYPE) for k, r in zip(game, resets.tolist(), strict=True)]
        settings = Settings(float(protocol.fps), protocol.frames, DTYPE, FRESH, every)
        plays = [scenes[k] for k in game]
        played = PlanBatch(plays, worlds, np.arange(len(game)), steps.astype(np.int32), settings, partition_of(None))
        played.play()
    columns = [
        played.success,
        played.steps.astype(np.int16),
        played.eliminations.astype(np.int8),
        played.fault.astype(np.int8),
    ]
    return columns, played.samples


def _movers(scenes: Sequence[Scene], game: Ints, samples: npt.NDArray[Any]) -> Poses:
    """Return the poses of what moves, (B, 150, M, 3), NaN beyond a scene's movers; samples: of all objects."""
    movers = [np.flatnonzero(scene.dynamic) for scene in scenes]
    poses = np.full((len(game), FRAMES, max(map(len, movers)), 3), np.nan)
    for index, objects in enumerate(movers):
        rows = np.flatnonzero(game == index)
        poses[np.ix_(rows, np.arange(FRAMES), np.arange(len(objects)))] = samples[
            np.ix_(rows, np.arange(FRAMES), objects)
        ]
    return poses

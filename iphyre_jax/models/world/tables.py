"""Scenes and plays as arrays for the world models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from iphyre_jax.checks import show
from iphyre_jax.observations.official import scene_features
from iphyre_jax.physics.constants import SPRING_REST
from iphyre_jax.scenes import MAX_OBJECTS, Scene

NO_TIE, PIN, SPRING = 0, 1, 2

Array = Any  # of NumPy on the host, of JAX in programs
Floats = npt.NDArray[np.float32]


class SceneTables(NamedTuple):
    """What never changes of S scenes, each with at most twelve objects, M moving ones and T ties of each."""

    centre: Array  # (S, 12, 2) px at the start
    half: Array  # (S, 12, 2) px from the centre to an end; zero for balls
    radius: Array  # (S, 12) px, 0 if there is no such object
    ball: Array  # (S, 12) bool
    eliminable: Array  # (S, 12) bool
    links: Array  # (S, 2, 12, 12) bool, two objects are tied by a pin, by a spring
    mover: Array  # (S, M) int32, object of each moving body; 0 if there are fewer
    moves: Array  # (S, M) bool, there is such a body
    tied: Array  # (S, M, T) int32, the object at the other end
    tie: Array  # (S, M, T) int32, NO_TIE, PIN or SPRING
    rest: Array  # (S, M, T) px, the length at rest


def sizes(scenes: Sequence[Scene]) -> tuple[int, int]:
    """The largest numbers of moving bodies and of ties of one body, at least 1."""
    movers = max((int(scene.dynamic.sum()) for scene in scenes), default=1)
    ties = [
        sum(index in pair for pair in (*scene.joints, *scene.springs)) for scene in scenes for index in _movers(scene)
    ]
    return max(1, movers), max([1, *ties])


def _movers(scene: Scene) -> list[int]:
    return [int(index) for index in np.flatnonzero(scene.dynamic)]


def scene_tables(scenes: Sequence[Scene], movers: int = 0, ties: int = 0) -> SceneTables:
    """The tables of some scenes.

    Args:
        scenes: with the official limits.
        movers: room for moving bodies; by default what the scenes need.
        ties: room for ties of each, likewise.

    Raises:
        ValueError: one line; a scene has more objects than a world model has rows.
    """
    need = sizes(scenes)
    room, ends = max(movers, need[0]), max(ties, need[1])
    for scene in scenes:
        if scene.n_objects > MAX_OBJECTS:
            raise ValueError(f"scene: expected at most {MAX_OBJECTS} objects, {show(scene.name)} has {scene.n_objects}")
    return SceneTables(
        *(np.stack(parts) for parts in zip(*(_table(scene, room, ends) for scene in scenes), strict=True))
    )


def _table(scene: Scene, room: int, ends: int) -> tuple[npt.NDArray[Any], ...]:
    features = scene_features(scene)
    centre = features.position[:MAX_OBJECTS].astype(np.float32)
    half = (features.ends[:MAX_OBJECTS, 1] - features.ends[:MAX_OBJECTS, 0]).astype(np.float32) / 2
    ball = np.zeros(MAX_OBJECTS, bool)
    ball[scene.n_blocks : scene.n_objects] = True
    eliminable = features.constants[:MAX_OBJECTS, 1] > 0
    links = np.zeros((2, MAX_OBJECTS, MAX_OBJECTS), bool)
    for kind, pairs in enumerate((scene.joints, scene.springs)):
        for i, j in pairs:
            links[kind, i, j] = links[kind, j, i] = True
    mover, moves = np.zeros(room, np.int32), np.zeros(room, bool)
    tied, tie = np.zeros((2, room, ends), np.int32)
    rest = np.zeros((room, ends), np.float32)
    for row, index in enumerate(_movers(scene)):
        mover[row], moves[row] = index, True
        linked = [(pair, PIN) for pair in scene.joints] + [(pair, SPRING) for pair in scene.springs]
        own = [(pair[1] if pair[0] == index else pair[0], kind) for pair, kind in linked if index in pair]
        for column, (other, kind) in enumerate(own):
            tied[row, column], tie[row, column] = other, kind
            away = float(np.linalg.norm(centre[index] - centre[other]))
            rest[row, column] = away if kind == PIN else SPRING_REST
    radius = features.constants[:MAX_OBJECTS, 0].astype(np.float32)
    return centre, half, radius, ball, eliminable, links, mover, moves, tied, tie, rest


class State(NamedTuple):
    """Moving bodies of B worlds at a moment."""

    centre: Array  # (B, M, 2) px
    angle: Array  # (B, M) rad since the tables' half axes
    velocity: Array  # (B, M, 2) px/s
    spin: Array  # (B, M) rad/s


def state_of(packed: Array) -> State:
    """From (..., M, 6): x, y, angle, vx, vy, spin."""
    return State(packed[..., 0:2], packed[..., 2], packed[..., 3:5], packed[..., 5])


class Plays(NamedTuple):
    """N plays of S scenes, with M moving bodies and the instants 0, ..., 149."""

    scenes: SceneTables
    scene: Array  # (N,) int32 index of the scene
    state: Array  # (N, 150, M, 6) x, y px, angle rad, vx, vy px/s, spin rad/s
    valid: Array  # int32, (N,) instants before the end of the play
    gone: Array  # int32, (N, 12) instant from which on an object is gone
    success: Array  # (N,) bool
    end: Array  # (N,) int32, physics steps made

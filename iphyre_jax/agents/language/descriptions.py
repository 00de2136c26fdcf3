"""Scenes and their present states in words and numbers, as a language model reads them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.observations.official import object_rows, scene_features
from iphyre_jax.physics.constants import SPRING_REST
from iphyre_jax.rules import DECISIONS_PER_SECOND
from iphyre_jax.scenes import Scene

Poses = npt.NDArray[np.floating]

EVERY: Final = 0.5  # s, between two rows of a table of positions


def object_names(scene: Scene) -> list[str]:
    """Return what a prompt calls each object: "index 0" the eliminable blocks, "bar A" the others, "ball 1"."""
    names: list[str] = []
    others = 0
    for block in range(scene.n_blocks):
        if scene.eliminable[block]:
            names.append(f"index {scene.eliminable_blocks.index(block)}")
        else:
            names.append(f"bar {chr(ord('A') + others)}" if others < 26 else f"bar {others}")
            others += 1
    return [*names, *(f"ball {number + 1}" for number in range(scene.n_balls))]


def describe_scene(scene: Scene) -> str:
    """Return the objects of a scene at its start, px, one a line, and what is tied to what."""
    poses = scene.start_poses
    names = object_names(scene)
    removable = set(scene.eliminable_blocks)
    parts = ["Blocks that you can remove:", *(_block(scene, poses, names, block) for block in sorted(removable))]
    others = [block for block in range(scene.n_blocks) if block not in removable]
    parts += ["Other blocks:", *(_block(scene, poses, names, block) for block in others)] if others else []
    parts += ["Balls:", *(_ball(scene, poses, names, ball) for ball in range(scene.n_blocks, scene.n_objects))]
    ties = [f"{names[a]} and {names[b]}: their centres keep their distance" for a, b in scene.joints]
    ties += [
        f"{names[a]} and {names[b]}: a spring of rest length {SPRING_REST:g} px between their centres"
        for a, b in scene.springs
    ]
    return "\n".join([*parts, *(["Tied together:", *ties] if ties else [])])


def describe_state(scene: Scene, poses: Poses, earlier: Poses, rate: float = DECISIONS_PER_SECOND) -> str:
    """Return what moves or is gone, as it is now.

    Args:
        scene: the scene.
        poses: (N, 3) px, px, rad; NaN for an object that was removed.
        earlier: the same before, for velocities.
        rate: spans between the two in a second.
    """
    names = object_names(scene)
    lines = []
    for index, name in enumerate(names):
        if np.isnan(poses[index, 0]):
            lines.append(f"{name}: removed")
        elif scene.dynamic[index]:
            is_ball = index >= scene.n_blocks
            where = _ball(scene, poses, names, index) if is_ball else _block(scene, poses, names, index)
            speed = (poses[index, :2] - earlier[index, :2]) * rate
            lines.append(f"{where}, velocity {_point(speed)} px/s")
    return "\n".join(lines)


def describe_attempt(scene: Scene, attempt: Attempt, number: int, *, positions: bool) -> str:
    """Return how an attempt ended; with positions also where the balls were every 0.5 s, px."""
    went = [f"index {slot} at {time:.2f} s" for slot, time in enumerate(attempt.times) if not np.isnan(time)]
    ended = "solved" if attempt.success else "not solved"
    lines = [
        f"Attempt {number}: asked for {', '.join(went) or 'no removal'}; {ended} after {attempt.seconds:.2f} s with "
        f"{attempt.eliminations} removed; reward {attempt.reward:.1f}."
    ]
    if positions and attempt.poses is not None:
        last = round(attempt.seconds * DECISIONS_PER_SECOND)
        for row in range(0, min(len(attempt.poses), last + 1), round(EVERY * DECISIONS_PER_SECOND)):
            balls = attempt.poses[row, scene.n_blocks : scene.n_objects]
            places = ", ".join(f"ball {ball + 1} {_point(pose)}" for ball, pose in enumerate(balls))
            lines.append(f"  {row / DECISIONS_PER_SECOND:.1f} s: {places}")
    return "\n".join(lines)


def official_table(scene: Scene) -> str:
    """Return the official array of a scene at its start, rows of nine numbers in px, rows of zeros included."""
    features = scene_features(scene)
    rows = object_rows(features, features.position, np.zeros(len(features.present)), features.present)
    return "[" + ",\n ".join("[" + ", ".join(f"{value:g}" for value in row) + "]" for row in rows.tolist()) + "]"


def _block(scene: Scene, poses: Poses, names: Sequence[str], block: int) -> str:
    half = (scene.blocks[block, 1] - scene.blocks[block, 0]) / 2
    cos, sin = np.cos(poses[block, 2]), np.sin(poses[block, 2])
    turned = np.array([half[0] * cos - half[1] * sin, half[0] * sin + half[1] * cos])
    centre = poses[block, :2]
    kind = "moves" if scene.dynamic[block] else "fixed"
    return (
        f"{names[block]}: {kind}, from {_point(centre - turned)} to {_point(centre + turned)}, centre {_point(centre)}"
    )


def _ball(scene: Scene, poses: Poses, names: Sequence[str], index: int) -> str:
    radius = scene.balls[index - scene.n_blocks, 2]
    kind = "" if scene.dynamic[index] else "fixed, "
    return f"{names[index]}: {kind}centre {_point(poses[index])}, radius {radius:g}"


def _point(values: Poses) -> str:
    x, y = (round(float(value), 1) + 0.0 for value in values[:2])  # + 0.0: no minus before a zero
    return f"({x:g}, {y:g})"

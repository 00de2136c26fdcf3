"""A scene in the reference engine, built and played as the official class does.

This is the project's only import of pymunk. Everything the official simulator sets (masses, moments, friction,
order of insertion, order of removal) is set here in the same order, because the order in which a space receives its
shapes decides the order in which contacts are solved.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pymunk
from numpy.typing import NDArray
from pymunk._chipmunk_cffi import lib

from iphyre_jax import Scene
from iphyre_jax.checks import check_whole
from parity.engines.trajectory import Trajectory

GRAVITY = (0.0, 100.0)  # px/s^2, y points down
MASS = 1.0
BAR_RADIUS = 10.0  # px
FRICTION = 0.5
ELASTICITY = 0.1
SPRING_REST_LENGTH = 20.0  # px
SPRING_STIFFNESS = 1.0
SPRING_DAMPING = 0.3
GOAL_Y = 600.0  # a game is solved when every ball's y is strictly greater after one and the same step

VERSION = pymunk.version

_position, _angle = lib.cpBodyGetPosition, lib.cpBodyGetAngle


@dataclass(frozen=True, eq=False)
class BodyState:
    """Motion of all objects of a scene at one moment; NaN where an object is gone.

    Attributes:
        position: (N, 2) float64, px.
        angle: (N,) float64, rad.
        velocity: (N, 2) float64, px/s.
        angular_velocity: (N,) float64, rad/s.
    """

    position: NDArray[np.float64]
    angle: NDArray[np.float64]
    velocity: NDArray[np.float64]
    angular_velocity: NDArray[np.float64]


class ReferenceWorld:
    """A pymunk space that holds one scene.

    Args:
        scene: the scene; every object becomes one body with one shape.
        resets: how often the space is filled, at least 1. The official class empties and refills one space at each
            reset; shape ids keep counting, which moves the iteration order of its hash tables and the contact ids.
        gravity: factor of the gravity.

    Raises:
        ValueError: if `resets` is less than 1.
    """

    def __init__(self, scene: Scene, resets: int = 1, gravity: float = 1.0) -> None:
        check_whole("resets", resets)
        self.scene = scene
        self.space = pymunk.Space()
        self.space.gravity = GRAVITY[0], GRAVITY[1] * gravity
        self.bodies: list[pymunk.Body] = []
        self.shapes: list[pymunk.Shape] = []
        self.constraints: list[tuple[int, int, pymunk.Constraint]] = []
        self.alive: list[bool] = []
        for _ in range(resets):
            self._empty()
            self._fill()
        # The engine's own bodies: its functions take half the time of pymunk's properties.
        self._moving = [body._body for body, moves in zip(self.bodies, scene.dynamic, strict=True) if moves]
        self._balls = [body._body for body in self.bodies[scene.n_blocks :]]

    def _empty(self) -> None:
        """Remove everything in the order of the official reset: shape and body of each object, then constraints."""
        for shape, body in zip(self.shapes, self.bodies, strict=True):
            self.space.remove(shape, body)
        for _, _, constraint in self.constraints:
            self.space.remove(constraint)

    def _fill(self) -> None:
        """Add blocks in list order, then balls, pin joints and springs."""
        scene = self.scene
        pairs = [_bar(scene.blocks[i], bool(scene.dynamic[i])) for i in range(scene.n_blocks)]
        pairs += [_ball(ball) for ball in scene.balls]
        for body, shape in pairs:
            shape.friction = FRICTION
            shape.elasticity = ELASTICITY
            self.space.add(body, shape)
        self.bodies = [body for body, _ in pairs]
        self.shapes = [shape for _, shape in pairs]
        self.alive = [True] * len(pairs)
        self.constraints = []
        for i, j in scene.joints:
            self._add_constraint(i, j, pymunk.PinJoint(self.bodies[i], self.bodies[j]))
        for i, j in scene.springs:
            ends = (self.bodies[i], self.bodies[j], (0.0, 0.0), (0.0, 0.0))
            self._add_constraint(i, j, pymunk.DampedSpring(*ends, SPRING_REST_LENGTH, SPRING_STIFFNESS, SPRING_DAMPING))

    def _add_constraint(self, i: int, j: int, constraint: pymunk.Constraint) -> None:
        self.space.add(constraint)
        self.constraints.append((i, j, constraint))

    def eliminate(self, index: int) -> None:
        """Remove object `index`: shape, body, then its joints and springs, as the official class does."""
        self.space.remove(self.shapes[index], self.bodies[index])
        for entry in [entry for entry in self.constraints if index in entry[:2]]:
            self.space.remove(entry[2])
            self.constraints.remove(entry)
        self.alive[index] = False

    def solved(self) -> bool:
        """Whether the centre of every ball is below the goal line now."""
        return all(_position(ball).y > GOAL_Y for ball in self._balls)

    def moving_poses(self) -> list[float]:
        """x, y and angle of the moving objects now, one after the other."""
        out: list[float] = []
        for body in self._moving:
            at = _position(body)
            out += (at.x, at.y, _angle(body))
        return out

    def poses(self) -> NDArray[np.float64]:
        """x, y and angle of every object, (N, 3) float64, NaN where it is gone."""
        out = np.full((len(self.bodies), 3), np.nan)
        for i, body in enumerate(self.bodies):
            if self.alive[i]:
                out[i] = *body.position, body.angle
        return out

    def state(self) -> BodyState:
        """Poses and velocities of every object now."""
        poses = self.poses()
        motion = np.full(poses.shape, np.nan)
        for i, body in enumerate(self.bodies):
            if self.alive[i]:
                motion[i] = *body.velocity, body.angular_velocity
        return BodyState(poses[:, :2], poses[:, 2], motion[:, :2], motion[:, 2])


def _bar(ends: NDArray[np.float64], dynamic: bool) -> tuple[pymunk.Body, pymunk.Shape]:
    """A block: a segment whose body sits at its midpoint, with the end points relative to it."""
    (x1, y1), (x2, y2) = ends.tolist()
    x, y = (x1 + x2) / 2, (y1 + y2) / 2
    if dynamic:
        # The official class gives every moving bar the moment of a segment without length, 66.67.
        body = pymunk.Body(MASS, pymunk.moment_for_segment(MASS, (0, 0), (0, 0), BAR_RADIUS))
    else:
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
    body.position = x, y
    return body, pymunk.Segment(body, (x1 - x, y1 - y), (x2 - x, y2 - y), BAR_RADIUS)


def _ball(ball: NDArray[np.float64]) -> tuple[pymunk.Body, pymunk.Shape]:
    x, y, radius = ball.tolist()
    body = pymunk.Body(MASS, pymunk.moment_for_circle(MASS, 0, radius))
    body.position = x, y
    return body, pymunk.Circle(body, radius)


def schedule(scene: Scene, eliminate_at: NDArray[np.integer[Any]]) -> dict[int, list[int]]:
    """Objects to remove before each step, in column order.

    Args:
        scene: the scene; column s of a plan is its s-th eliminable block.
        eliminate_at: (S,) integers, 0-based step before which a block goes, -1 for never.

    Returns:
        Object indices by step; steps without an elimination have no entry.
    """
    due: dict[int, list[int]] = {}
    for column, step in enumerate(eliminate_at.tolist()):
        if step >= 0:
            due.setdefault(step, []).append(scene.eliminable_blocks[column])
    return due


def run(
    scene: Scene,
    eliminate_at: NDArray[np.integer[Any]],
    *,
    fps: int,
    steps: int,
    resets: int = 1,
    sample_every: int = 1,
    gravity: float = 1.0,
) -> Trajectory:
    """Play one plan in a space of its own, with the meaning `iphyre_jax.simulate` gives it.

    Args:
        scene: the scene to play.
        eliminate_at: (S,) integers as for `iphyre_jax.simulate`.
        fps: physics steps a second.
        steps: the most steps to make; the play stops earlier with the step that solves it.
        resets: see `ReferenceWorld`.
        sample_every: steps between samples.
        gravity: factor of the gravity; shows what a small disturbance does.

    Returns:
        The outcome with its samples, K = steps // sample_every + 1.
    """
    world = ReferenceWorld(scene, resets, gravity)
    due = schedule(scene, eliminate_at)
    poses = world.poses()
    track, step_space, dt = [world.moving_poses()], world.space.step, 1.0 / fps
    removed: dict[int, int] = {}
    made, solved = 0, False
    while made < steps and not solved:
        for index in due.get(made, ()):
            world.eliminate(index)
            removed[index] = made
        step_space(dt)
        made += 1
        solved = world.solved()
        if made % sample_every == 0:
            track.append(world.moving_poses())
    samples = np.repeat(poses[None], steps // sample_every + 1, axis=0)
    moving = np.flatnonzero(scene.dynamic)
    samples[: len(track), moving] = np.array(track).reshape(len(track), -1, 3)
    samples[len(track) :, moving] = np.array(world.moving_poses()).reshape(-1, 3)
    for index, when in removed.items():
        samples[when // sample_every + 1 :, index] = np.nan
    return Trajectory(solved, made, len(removed), samples)

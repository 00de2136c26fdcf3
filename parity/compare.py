"""Compare two engines' plays of the same plans."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from iphyre_jax import Simulation
from parity.engines.trajectory import Trajectory
from parity.tolerances import IN_PLAY_CENTRE_X, IN_PLAY_MAX_DX, IN_PLAY_MAX_Y

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BIN = 0.1  # s: an error over time keeps the largest error of every such interval


@dataclass(frozen=True, eq=False)
class PlanComparison:
    """The plans of one game, ours against the reference; every array has one entry a plan (B,).

    Attributes:
        error: px, largest distance of a moving object from its place in the reference while it is in play; inf if our
            play ends in a fault or holds a value that is not finite.
        error_over_time: (B, bins) px, float32, the largest such distance in every `BIN` seconds; NaN where nothing is
            in play.
        identical: every pose of every moving object, in play or not, is equal bit for bit.
        reference_success: the reference solves the game.
        reference_steps: steps that the reference made.
        success: ours solves the game.
        steps: steps that ours made.
        same_eliminations: both removed the same number of blocks.
        same_presence: both held the same objects at every step (compared if both made equally many steps).
        fault: our fault code, 0 if sound.
    """

    error: Floats
    error_over_time: NDArray[np.float32]
    identical: Bools
    reference_success: Bools
    reference_steps: Ints
    success: Bools
    steps: Ints
    same_eliminations: Bools
    same_presence: Bools
    fault: Ints

    @property
    def same_flag(self) -> Bools:
        """(B,) the same success flag."""
        return self.success == self.reference_success

    @property
    def same_step(self) -> Bools:
        """(B,) the same success step: both unsolved, or both solved by the same step."""
        return self.same_flag & (~self.reference_success | (self.steps == self.reference_steps))


def in_play(samples: Floats) -> Bools:
    """Whether each object (..., 3) is near enough to the picture for its position to matter, (...,) bool."""
    inside = np.abs(samples[..., 0] - IN_PLAY_CENTRE_X) <= IN_PLAY_MAX_DX
    return inside & (samples[..., 1] <= IN_PLAY_MAX_Y)


def play_errors(reference: Floats, ours: Floats, moving: Bools, last: int) -> Floats:
    """Errors of the places of one plan, px.

    Args:
        reference: (K, N, 3) poses.
        ours: (K, N, 3) poses of the play under test.
        moving: (N,) which objects move.
        last: index of the reference's last sample; later ones only repeat its last pose.

    Returns:
        (last + 1,) for every sample the largest error of any moving object that is in play in the reference, NaN if
        none is. A place of ours that is not finite counts as infinitely far.
    """
    theirs, mine = reference[: last + 1, moving], ours[: last + 1, moving]
    distance = np.hypot(mine[..., 0] - theirs[..., 0], mine[..., 1] - theirs[..., 1])
    return largest(np.where(in_play(theirs), np.where(np.isfinite(distance), distance, np.inf), np.nan), 1)


def largest(errors: NDArray[Any], axis: int) -> NDArray[Any]:
    """The largest error along an axis, NaN where none is known."""
    most = np.where(np.isnan(errors), -1.0, errors).max(axis, initial=-1.0)
    return np.where(most < 0, np.nan, most)


def _overall(errors: Floats) -> float:
    return float(np.max(errors[~np.isnan(errors)], initial=0.0))


def binned(errors: Floats, fps: float, samples: int) -> NDArray[np.float32]:
    """The largest error in every `BIN` seconds, (bins,) float32, NaN where there is none.

    Args:
        errors: (steps + 1,) after every step, NaN where nothing is in play.
        fps: physics steps a second.
        samples: length of a whole play, K.
    """
    width = max(1, round(BIN * fps))
    whole = np.full(-(-samples // width) * width, np.nan)
    whole[: len(errors)] = errors
    return largest(whole.reshape(-1, width), 1).astype(np.float32)


def _same_bits(one: Floats, other: Floats) -> bool:
    """Return whether all numbers have the same bits; 0.0 and -0.0, which are equal, have not."""
    return one.tobytes() == other.tobytes()


def compare_plans(
    references: Sequence[Trajectory], ours: Simulation, moving: Bools, fps: float, every: int = 1
) -> PlanComparison:
    """Compare one game's plans.

    Args:
        references: the reference's plays, one a plan.
        ours: our plays of the same plans, sampled at the same steps.
        moving: (N,) which objects move.
        fps: physics steps a second.
        every: steps between samples.

    Returns:
        The comparison, one entry a plan.

    Raises:
        ValueError: our plays carry no samples, or samples of another shape than the reference's.
    """
    if ours.samples is None:
        raise ValueError("samples: expected sampled plays, got none")
    expected = (len(references), *references[0].samples.shape)
    if ours.samples.shape != expected:
        raise ValueError(f"samples: expected shape {expected}, got {ours.samples.shape}")
    pairs = [(one, other.astype(np.float64)) for one, other in zip(references, ours.samples, strict=True)]
    errors = [play_errors(one.samples, samples, moving, one.steps // every) for one, samples in pairs]
    fault = np.asarray(ours.fault, dtype=np.int64)
    sound = fault == 0
    reference_steps = np.array([reference.steps for reference in references], dtype=np.int64)
    presence = [np.array_equal(np.isnan(one.samples[..., 0]), np.isnan(samples[..., 0])) for one, samples in pairs]
    same_steps = np.asarray(ours.steps) == reference_steps
    same_poses = [_same_bits(one.samples[:, moving], samples[:, moving]) for one, samples in pairs]
    return PlanComparison(
        error=np.where(sound, [_overall(distance) for distance in errors], np.inf),
        error_over_time=np.stack([binned(distance, fps / every, expected[1]) for distance in errors]),
        identical=np.array(same_poses) & same_steps & sound,
        reference_success=np.array([reference.success for reference in references]),
        reference_steps=reference_steps,
        success=np.asarray(ours.success),
        steps=np.asarray(ours.steps, dtype=np.int64),
        same_eliminations=np.array([reference.eliminations for reference in references]) == ours.eliminations,
        same_presence=np.array(presence) | ~same_steps,
        fault=fault,
    )

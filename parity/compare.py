"""How far two sets of plays of the same plans are apart."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from parity.reference import Trajectory
from parity.tolerances import EXACT_ERROR, IN_PLAY_CENTRE_X, IN_PLAY_MAX_DX, IN_PLAY_MAX_Y, SHARE_LIMITS

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BIN = 0.1  # s: the course of an error is kept as its maximum in so long a time


class Played(Protocol):
    """What is compared with the reference: the fields of `iphyre_jax.Simulation` that this needs."""

    @property
    def success(self) -> NDArray[np.bool_]:
        """(B,) solved."""

    @property
    def steps(self) -> NDArray[np.integer]:
        """(B,) steps made."""

    @property
    def eliminations(self) -> NDArray[np.integer]:
        """(B,) blocks removed."""

    @property
    def fault(self) -> NDArray[np.integer]:
        """(B,) 0 where sound."""

    @property
    def samples(self) -> NDArray[np.floating] | None:
        """(B, K, N, 3) poses after every step."""


@dataclass(frozen=True, eq=False)
class PlanComparison:
    """One game's plans, ours against the reference; every array has one entry a plan (B,).

    Attributes:
        error: px, largest distance of a moving object from its reference while that is in play; inf where ours
            faulted or is not finite.
        angle_error: rad, the same of the angles.
        course: (B, bins) px, float32, the largest such distance in every `BIN` seconds; NaN where nothing is in play.
        identical: every pose of every moving object, in play or not, is equal bit for bit.
        reference_success: solved in the reference.
        reference_steps: steps the reference made.
        success: solved in ours.
        steps: steps ours made.
        same_eliminations: both removed the same number of blocks.
        same_presence: the same objects were there at the same steps (where both ended with the same step).
        fault: our fault code, 0 if sound.
    """

    error: Floats
    angle_error: Floats
    course: NDArray[np.float32]
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


def play_errors(reference: Floats, ours: Floats, moving: Bools, steps: int) -> tuple[Floats, Floats]:
    """Position (px) and angle (rad) errors of one plan.

    Args:
        reference: (K, N, 3) poses after every step.
        ours: (K, N, 3) the same of the plays under test.
        moving: (N,) which objects move.
        steps: steps the reference made; later samples only repeat its last pose.

    Returns:
        For every sample up to the last step the two maxima over the moving objects that are in play in the reference,
        (steps + 1,) each, NaN where there is none. Not-finite poses of ours count as infinitely far.
    """
    theirs, mine = reference[: steps + 1, moving], ours[: steps + 1, moving]
    offset = mine - theirs
    counted = in_play(theirs)
    return _worst(np.hypot(offset[..., 0], offset[..., 1]), counted), _worst(np.abs(offset[..., 2]), counted)


def _worst(values: Floats, counted: Bools) -> Floats:
    """Maximum over the counted objects of each sample."""
    values = np.where(np.isfinite(values), values, np.inf)
    most = np.max(np.where(counted, values, -1.0), axis=1, initial=-1.0)
    return np.where(most < 0, np.nan, most)


def _overall(course: Floats) -> float:
    return float(np.max(course[~np.isnan(course)], initial=0.0))


def binned(course: Floats, fps: float, samples: int) -> NDArray[np.float32]:
    """The maximum of a course (steps + 1,) in every `BIN` seconds, (bins,) float32, NaN where it has no value.

    Args:
        course: errors after every step.
        fps: physics steps a second.
        samples: length of a whole course, K.
    """
    width = max(1, round(BIN * fps))
    whole = np.full(-(-samples // width) * width, np.nan)
    whole[: len(course)] = course
    filled = np.where(np.isnan(whole), -1.0, whole).reshape(-1, width).max(axis=1)
    return np.where(filled < 0, np.nan, filled).astype(np.float32)


def compare_plans(references: Sequence[Trajectory], ours: Played, moving: Bools, fps: float) -> PlanComparison:
    """Compare one game's plans, sampled after every step.

    Args:
        references: the reference's plays, one a plan.
        ours: our plays of the same plans, with samples after every step.
        moving: (N,) which objects move.
        fps: physics steps a second.

    Returns:
        The comparison, one entry a plan.

    Raises:
        ValueError: if our plays carry no samples, or not as many as the reference's.
    """
    if ours.samples is None:
        raise ValueError("samples: expected plays sampled after every step, got none")
    expected = (len(references), *references[0].samples.shape)
    if ours.samples.shape != expected:
        raise ValueError(f"samples: expected shape {expected}, got {ours.samples.shape}")
    pairs = [(one, other.astype(np.float64)) for one, other in zip(references, ours.samples, strict=True)]
    courses = [play_errors(one.samples, samples, moving, one.steps) for one, samples in pairs]
    fault = np.asarray(ours.fault, dtype=np.int64)
    sound = fault == 0
    reference_steps = np.array([reference.steps for reference in references], dtype=np.int64)
    presence = [np.array_equal(np.isnan(one.samples[..., 0]), np.isnan(samples[..., 0])) for one, samples in pairs]
    same_steps = np.asarray(ours.steps) == reference_steps
    same_poses = [np.array_equal(one.samples[:, moving], samples[:, moving]) for one, samples in pairs]
    return PlanComparison(
        error=np.where(sound, [_overall(distance) for distance, _ in courses], np.inf),
        angle_error=np.where(sound, [_overall(turn) for _, turn in courses], np.inf),
        course=np.stack([binned(distance, fps, expected[1]) for distance, _ in courses]),
        identical=np.array(same_poses) & same_steps & sound,
        reference_success=np.array([reference.success for reference in references]),
        reference_steps=reference_steps,
        success=np.asarray(ours.success),
        steps=np.asarray(ours.steps, dtype=np.int64),
        same_eliminations=np.array([reference.eliminations for reference in references]) == ours.eliminations,
        same_presence=np.array(presence) | ~same_steps,
        fault=fault,
    )


@dataclass(frozen=True)
class Summary:
    """One row of a table: a game's plans, or those of all games together.

    Attributes:
        name: the game, or "all".
        plans: number of plans.
        solved: plans the reference solves.
        max_error: px, the largest error in play of any plan.
        shares: share of the plans within each of `tolerances.SHARE_LIMITS`.
        identical: share of the plans whose poses are all equal bit for bit.
        share_solved: share within `tolerances.EXACT_ERROR` of the plans the reference solves; None where there is none.
        same_flag: share of the plans with the same success flag.
        same_step: share of the plans with the same success step.
        same_flag_solved: the same of the plans the reference solves; None where there is none.
        same_step_solved: the same of the plans the reference solves; None where there is none.
        same_bookkeeping: share of the plans with the same eliminations and the same objects present.
        faults: plans that ended in a fault.
    """

    name: str
    plans: int
    solved: int
    max_error: float
    shares: tuple[float, ...]
    identical: float
    share_solved: float | None
    same_flag: float
    same_step: float
    same_flag_solved: float | None
    same_step_solved: float | None
    same_bookkeeping: float
    faults: int

    def within(self, limit: float) -> float:
        """Share of the plans within `limit` px, one of `tolerances.SHARE_LIMITS`."""
        return self.shares[SHARE_LIMITS.index(limit)]


def summarise(name: str, comparisons: Sequence[PlanComparison]) -> Summary:
    """Pool the plans of one or more games into one row.

    Args:
        name: what the row is called.
        comparisons: at least one game's comparison, with at least one plan in all.

    Returns:
        The row.
    """
    error = np.concatenate([c.error for c in comparisons])
    flag = np.concatenate([c.same_flag for c in comparisons])
    step = np.concatenate([c.same_step for c in comparisons])
    solved = np.concatenate([c.reference_success for c in comparisons])
    books = np.concatenate([c.same_eliminations & c.same_presence for c in comparisons])
    return Summary(
        name=name,
        plans=len(error),
        solved=int(solved.sum()),
        max_error=float(error.max()),
        shares=tuple(float(np.mean(error <= limit)) for limit in SHARE_LIMITS),
        identical=float(np.concatenate([c.identical for c in comparisons]).mean()),
        share_solved=float(np.mean(error[solved] <= EXACT_ERROR)) if solved.any() else None,
        same_flag=float(flag.mean()),
        same_step=float(step.mean()),
        same_flag_solved=float(flag[solved].mean()) if solved.any() else None,
        same_step_solved=float(step[solved].mean()) if solved.any() else None,
        same_bookkeeping=float(books.mean()),
        faults=int(sum(np.count_nonzero(c.fault) for c in comparisons)),
    )

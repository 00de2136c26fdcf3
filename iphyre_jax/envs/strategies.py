"""The paper's three strategies: which blocks an action removes, how far it plays, and which flags end an episode.

A strategy reads an action at the start of a frame (0.1 s). It plans the physics step before which each slot's block
goes, and the step to play to. There are six slots, or as many as the scenes' limits allow blocks. A slot without a
block, or whose block is gone, does nothing and costs nothing. Shapes are those of one world; lanes (further worlds) may
stand behind every axis.
Source: `IPHYRE_inadvance`, `IPHYRE_onthefly` and `IPHYRE_combine` of the official repository.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np

from iphyre_jax.checks import show
from iphyre_jax.envs.protocols import EpisodeProtocol
from iphyre_jax.envs.spaces import Box, Discrete, Space
from iphyre_jax.physics import lanes
from iphyre_jax.rules import FRAMES, NEVER, TIME_LIMIT
from iphyre_jax.scenes import MAX_ELIMINABLE

StrategyName = Literal["in-advance", "on-the-fly", "combined"]


class PlannedAction(NamedTuple):
    """What the physics plays for an action."""

    plan: jax.Array  # (slots,) int32, the step before which each slot's block goes; -1 for never
    stop_step: jax.Array  # () int32, the step at which the next action is due
    executed: jax.Array  # (slots,) bool, slots executed by then


class Ending(NamedTuple):
    """The flags of a transition, () bool each."""

    terminated: jax.Array
    truncated: jax.Array


class _Times:
    """An action gives the time of each slot, as a share of 15 s."""

    slots: int

    def action_space(self) -> Space:
        """Return the space of actions: (slots,) float32 in [0, 1]."""
        return Box(0.0, 1.0, (self.slots,))

    def ending(self, success: jax.Array, out_of_time: jax.Array) -> Ending:
        """Return the flags of a transition; see `Strategy`."""
        return Ending(success, out_of_time & ~success)


@dataclass(frozen=True)
class InAdvance(_Times):
    """All times are given at the start, as six shares of 15 s: one decision an episode.

    Times are rounded to 0.1 s; a block stays at 0 and from 15.0 s on. Of equal times only that of the lowest slot
    counts. `plans.plan_to_steps` has the same rule for seconds in NumPy; a test holds the two equal. Success is
    terminated, failure is truncated.
    """

    name: StrategyName = "in-advance"
    slots: int = MAX_ELIMINABLE
    decisions: int = 1
    no_op_candidate: bool = False

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Plan an action; see `Strategy`."""
        frames = removal_frames(action)
        counts = _is_lowest(frames) & (frames >= 1) & (frames < FRAMES)
        plan = jnp.where(counts, frames * protocol.steps_per_frame, NEVER)
        return PlannedAction(plan, jnp.full_like(step, protocol.steps), executed)


@dataclass(frozen=True)
class OnTheFly:
    """Every 0.1 s one of seven actions: 0 does nothing, i removes the block of slot i - 1.

    A game solved in the last frame is both terminated and truncated.
    """

    name: StrategyName = "on-the-fly"
    slots: int = MAX_ELIMINABLE
    decisions: int = FRAMES
    no_op_candidate: bool = True

    def action_space(self) -> Space:
        """Return the space of actions: the whole numbers from 0 to slots."""
        return Discrete(self.slots + 1)

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Plan an action; see `Strategy`."""
        slot = lanes.iota(self.slots, step) + 1
        plan = jnp.where(jnp.asarray(action).astype(jnp.int32)[None] == slot, step[None], NEVER)
        return PlannedAction(plan, step + protocol.steps_per_frame, executed)

    def ending(self, success: jax.Array, out_of_time: jax.Array) -> Ending:
        """Return the flags of a transition; see `Strategy`."""
        return Ending(success, out_of_time)


@dataclass(frozen=True)
class Combined(_Times):
    """Six shares of 15 s, given again after each removal.

    An action plays up to and including the frame of the next removal that is due. Later times may change; past times do
    nothing. A slot executes once: if its time is the next again, it does nothing, and another slot with the same time
    does nothing either. With nothing due the action plays to the end.

    Attributes:
        late_frame: reproduce a bug of the official code. Its clock has a 151st frame if the last action starts at one
            of 19 frames (87, 92, 97, 102, ...). That frame costs 0.1 more, and a time of 15.0 s can be executed in it.
    """

    name: StrategyName = "combined"
    slots: int = MAX_ELIMINABLE
    no_op_candidate: bool = False
    late_frame: bool = False

    @property
    def decisions(self) -> int:
        """The most decisions of an episode: each but the last removes a block."""
        return self.slots + 1

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Plan an action; see `Strategy`."""
        frames, now = removal_frames(action), step // protocol.steps_per_frame
        end = jnp.asarray(_ENDS if self.late_frame else np.full_like(_ENDS, FRAMES))[now]
        due = _is_lowest(frames) & ~executed & present & (frames >= jnp.maximum(now, 1)[None]) & (frames < end[None])
        frame = jnp.min(jnp.where(due, frames, end[None]), axis=0)
        chosen = due & (frames == frame[None])
        plan = jnp.where(chosen, (frame * protocol.steps_per_frame)[None], NEVER)
        stop_step = jnp.minimum(frame + 1, end) * protocol.steps_per_frame
        return PlannedAction(plan, stop_step, executed | chosen)


Strategy = InAdvance | OnTheFly | Combined
"""`plan_action(action, step, executed, present, protocol)` turns an action into a `PlannedAction`. `step` is the number
of physics steps made, () int32; `executed` and `present`, (slots,) bool, are the slots executed so far and those whose
block is still there. `ending(success, out_of_time)` returns the flags of a transition; an episode is out of time at its
last step, or when its world is no longer sound. `decisions` is the most that an episode may take."""

# The frame at which an episode ends on the official clock, for each frame at which its last action starts.
_ENDS: Final = np.array(
    [start + len(np.arange(start / 10, TIME_LIMIT, 1 / 10)) for start in range(FRAMES)] + [FRAMES + 1] * 2, np.int32
)

STRATEGIES: Final[Mapping[str, Strategy]] = MappingProxyType(
    {"in-advance": InAdvance(), "on-the-fly": OnTheFly(), "combined": Combined()}
)


def removal_frames(action: jax.Array) -> jax.Array:
    """Return the frame of each slot's removal, (slots,) int32: 15 x action, rounded to 0.1 s, half to even as in NumPy.

    NaN and times below 0 or above 15 s give -1.
    """
    action = jnp.asarray(action)
    # The official code rounds twice; without the barrier the compiler multiplies once, by 150.
    seconds = jax.lax.optimization_barrier(action * jnp.asarray(TIME_LIMIT, action.dtype))
    tenths = jnp.rint(seconds * jnp.asarray(10.0, action.dtype))
    return jnp.where((tenths >= 0) & (tenths <= FRAMES), tenths, NEVER).astype(jnp.int32)


def _is_lowest(frames: jax.Array) -> jax.Array:
    """Return which slots are the lowest of those with the same frame, (slots,) bool."""
    index = lanes.iota(frames.shape[0], frames[0])
    same = frames[:, None] == frames[None]
    return ~jnp.any(same & (index[None] < index[:, None]), axis=1)


def strategy_named(name: object, *, official_bugs: bool = False, slots: int = MAX_ELIMINABLE) -> Strategy:
    """Return a strategy.

    Raises:
        ValueError: no strategy has this name; one line.
    """
    if not isinstance(name, str) or name not in STRATEGIES:
        raise ValueError(f"strategy: expected one of {', '.join(get_args(StrategyName))}, got {show(name)}")
    if official_bugs and name == "combined":
        return Combined(slots=slots, late_frame=True)
    return replace(STRATEGIES[name], slots=slots)

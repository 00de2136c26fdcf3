"""The paper's three strategies: how an action becomes removals, how far it plays, and what its end is called.

A strategy reads an action at the start of a frame (0.1 s) and answers with steps: before which physics step each slot's
block goes, and up to which step to play. There are six slots, or as many as the scenes' limits allow blocks; those that
stand for no block, or for one that is gone, do nothing and cost nothing. Shapes are those of one world; lanes,
further worlds, may stand behind every axis.
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

from iphyre_jax.envs.protocols import FRAMES, EpisodeProtocol
from iphyre_jax.envs.spaces import Box, Discrete, Space
from iphyre_jax.physics import lanes
from iphyre_jax.scenes import MAX_ELIMINABLE

StrategyName = Literal["in-advance", "on-the-fly", "combined"]

TIME_LIMIT: Final = 15.0  # s
NEVER: Final = -1


class PlannedAction(NamedTuple):
    """What an action asks of the physics."""

    plan: jax.Array  # (slots,) int32, the step before which each slot's block goes, -1 for never
    stop_step: jax.Array  # () int32, steps made when the next action is due
    executed: jax.Array  # (slots,) bool, slots that were ever executed


class Ending(NamedTuple):
    """The flags of a transition, () bool each."""

    terminated: jax.Array
    truncated: jax.Array


@dataclass(frozen=True)
class InAdvance:
    """All times are given at the start: six shares of 15 s, one decision an episode.

    A time is rounded to 0.1 s; 0 and anything from 15.0 s on means that the block stays. Of equal times only that of
    the lowest slot counts, the others are lost. Success is reported as terminated, failure as truncated.
    """

    name: StrategyName = "in-advance"
    slots: int = MAX_ELIMINABLE
    decisions: int = 1
    no_op_candidate: bool = False

    def action_space(self) -> Space:
        """Return the space of actions: (slots,) float32 in [0, 1]."""
        return Box(0.0, 1.0, (self.slots,))

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Return what an action asks for; see `Strategy`."""
        frames = removal_frames(action)
        counts = _is_lowest(frames) & (frames >= 1) & (frames < FRAMES)
        plan = jnp.where(counts, frames * protocol.steps_per_frame, NEVER)
        return PlannedAction(plan, jnp.full_like(step, protocol.steps), executed)

    def ending(self, success: jax.Array, out_of_time: jax.Array) -> Ending:
        """Return the flags of a transition; see `Strategy`."""
        return Ending(success, out_of_time & ~success)


@dataclass(frozen=True)
class OnTheFly:
    """Every 0.1 s one of seven: 0 does nothing, i removes the block of slot i - 1.

    A game solved in the last frame is terminated and truncated at once.
    """

    name: StrategyName = "on-the-fly"
    slots: int = MAX_ELIMINABLE
    decisions: int = FRAMES
    no_op_candidate: bool = True

    def action_space(self) -> Space:
        """Return the space of actions: a whole number from 0 to slots."""
        return Discrete(self.slots + 1)

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Return what an action asks for; see `Strategy`."""
        slot = lanes.iota(self.slots, step) + 1
        plan = jnp.where(jnp.asarray(action).astype(jnp.int32)[None] == slot, step[None], NEVER)
        return PlannedAction(plan, step + protocol.steps_per_frame, executed)

    def ending(self, success: jax.Array, out_of_time: jax.Array) -> Ending:
        """Return the flags of a transition; see `Strategy`."""
        return Ending(success, out_of_time)


@dataclass(frozen=True)
class Combined:
    """Six shares of 15 s on the episode's clock, given anew after each removal.

    An action plays up to and including the frame of the first removal that is due from now on; later times may change,
    earlier ones are gone by. A slot executes once: if its time comes first again it does nothing, and neither does
    another slot of the same time. With nothing due the action plays to the end.

    Attributes:
        late_frame: reproduce a fault of the official code, whose clock has a 151st frame if the last action starts at
            one of 19 frames (87, 92, 97, 102, ...): it costs 0.1 more, and a time of 15.0 s can be executed in it.
    """

    name: StrategyName = "combined"
    slots: int = MAX_ELIMINABLE
    no_op_candidate: bool = False
    late_frame: bool = False

    @property
    def decisions(self) -> int:
        """The most that an episode may take: each but the last removes a block."""
        return self.slots + 1

    def action_space(self) -> Space:
        """Return the space of actions: (slots,) float32 in [0, 1]."""
        return Box(0.0, 1.0, (self.slots,))

    def plan_action(
        self, action: jax.Array, step: jax.Array, executed: jax.Array, present: jax.Array, protocol: EpisodeProtocol
    ) -> PlannedAction:
        """Return what an action asks for; see `Strategy`."""
        frames, now = removal_frames(action), step // protocol.steps_per_frame
        end = jnp.asarray(_ENDS if self.late_frame else np.full_like(_ENDS, FRAMES))[now]
        due = _is_lowest(frames) & ~executed & present & (frames >= jnp.maximum(now, 1)[None]) & (frames < end[None])
        frame = jnp.min(jnp.where(due, frames, end[None]), axis=0)
        chosen = due & (frames == frame[None])
        plan = jnp.where(chosen, (frame * protocol.steps_per_frame)[None], NEVER)
        stop_step = jnp.minimum(frame + 1, end) * protocol.steps_per_frame
        return PlannedAction(plan, stop_step, executed | chosen)

    def ending(self, success: jax.Array, out_of_time: jax.Array) -> Ending:
        """Return the flags of a transition; see `Strategy`."""
        return Ending(success, out_of_time & ~success)


Strategy = InAdvance | OnTheFly | Combined
"""`plan_action(action, step, executed, present, protocol)` turns an action into a `PlannedAction`. `step` is the number of
physics steps made, () int32; `executed` and `present`, (slots,) bool, are the slots executed so far and those whose
block is still there. `ending(success, out_of_time)` returns the flags of a transition; an episode is out of time at its
last step, or when its world is no longer sound. `decisions` is the most that an episode may take."""

# Frames at which an episode ends by the official clock, by the frame at which its last action starts.
_ENDS: Final = np.array(
    [start + len(np.arange(start / 10, TIME_LIMIT, 1 / 10)) for start in range(FRAMES)] + [FRAMES + 1] * 2, np.int32
)

STRATEGIES: Final[Mapping[str, Strategy]] = MappingProxyType(
    {"in-advance": InAdvance(), "on-the-fly": OnTheFly(), "combined": Combined()}
)


def removal_frames(action: jax.Array) -> jax.Array:
    """Return the frames that an action (slots,) names, int32: 15 x a rounded to 0.1 s, half to even, as NumPy does it.

    What is no number, or below 0 or above 15 s, is no frame of the episode.
    """
    action = jnp.asarray(action)
    # Two roundings, as in the official code; without the barrier a compiler multiplies by 150 once.
    seconds = jax.lax.optimization_barrier(action * jnp.asarray(TIME_LIMIT, action.dtype))
    tenths = jnp.rint(seconds * jnp.asarray(10.0, action.dtype))
    return jnp.where((tenths >= 0) & (tenths <= FRAMES), tenths, NEVER).astype(jnp.int32)


def _is_lowest(frames: jax.Array) -> jax.Array:
    """Return which slots have no lower slot of the same time beside them, (slots,) bool."""
    index = lanes.iota(frames.shape[0], frames[0])
    same = frames[:, None] == frames[None]
    return ~jnp.any(same & (index[None] < index[:, None]), axis=1)


def strategy_named(name: object, *, official_bugs: bool = False, slots: int = MAX_ELIMINABLE) -> Strategy:
    """Return a strategy.

    Raises:
        ValueError: there is none of this name; one line.
    """
    if not isinstance(name, str) or name not in STRATEGIES:
        raise ValueError(f"strategy: expected one of {', '.join(get_args(StrategyName))}, got {name!r}")
    if official_bugs and name == "combined":
        return Combined(slots=slots, late_frame=True)
    return replace(STRATEGIES[name], slots=slots)

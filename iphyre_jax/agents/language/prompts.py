"""Prompts: what a language model is asked. Texts of our own, each with a name, a version and a hash.

`paper` carries the information that the paper's prompt carries, its mistakes included (y is said to grow upwards, what
an index counts is left open, padding rows stand among the objects), so that its result can be replicated. `plain` says
the same rightly; `physics` adds the constants; `picture` adds a picture. The strategy decides when is asked; feedback
tells of earlier attempts.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from iphyre_jax.agents.language import descriptions
from iphyre_jax.agents.language.replies import ReplyForm
from iphyre_jax.attempts.protocol import Attempt, Feedback
from iphyre_jax.checks import check_option
from iphyre_jax.physics.constants import GRAVITY
from iphyre_jax.rules import DECISIONS_PER_SECOND
from iphyre_jax.scenes import Scene, load_scene

VERSION: Final = 1  # of all texts; a changed text takes the next number
PHYSICS_FPS: Final = 60  # steps a second, as the base `physics` says
Base = Literal["paper", "plain", "physics", "picture"]
Strategy = Literal["in-advance", "combined", "on-the-fly"]
Shown = Literal["outcome", "trajectory", "frames"]
BASES: Final[tuple[Base, ...]] = get_args(Base)
STRATEGIES: Final[tuple[Strategy, ...]] = get_args(Strategy)
SHOWN: Final[tuple[Shown, ...]] = get_args(Shown)
FORM_OF: Final[dict[Strategy, ReplyForm]] = {"in-advance": "plan", "combined": "next", "on-the-fly": "now"}
Role = Literal["system", "user", "assistant"]


class Message(NamedTuple):
    """A part of a conversation."""

    role: Role
    text: str
    pictures: tuple[bytes, ...] = ()  # PNG


class Moment(NamedTuple):
    """Where a play stands when its next removals are asked for."""

    seconds: float
    poses: descriptions.Poses  # (N, 3) px, px, rad
    earlier: descriptions.Poses  # 0.1 s before, or at the start if that is later
    rate: float = DECISIONS_PER_SECOND  # spans between the two in a second
    gone: frozenset[int] = frozenset()  # slots of the blocks that were removed


_SYSTEM: Final = "You play a game of physical reasoning. Think as long as you need, then answer in the form asked for."
_PAPER_SYSTEM: Final = "You are a helpful assistant."
_RULES: Final = """\
The world is a square of 600 x 600 px. x grows to the right and y grows DOWNWARDS: y = 0 is the upper edge, y = 600 the
lower one. Gravity pulls towards larger y. Blocks are bars with round ends, 20 px thick. What is fixed stays where it is
until it is removed; what moves falls, rolls, is pushed and pushes. Objects collide.
Goal: all balls are below the lower edge (y > 600) at one and the same moment, within 15 s.
You act only by removing blocks that can be removed. Each has an index, counted from 0 in the list below. A removed
block does not come back.
Reward: +1000 if the goal is reached, -10 for each removal, -1 for each second until the end. Doing nothing is allowed.
"""
_PHYSICS: Final = f"""\
Physics: gravity {GRAVITY:g} px/s^2; friction 0.5 and elasticity 0.1 of each object, multiplied where two touch, so that
hardly anything bounces; every moving object has mass 1; {PHYSICS_FPS} steps a second. From rest an object falls h px in
sqrt(2 h / {GRAVITY:g}) s: 50 px in 1 s, 200 px in 2 s. Round ends of bars reach 10 px beyond the end points.
"""
_PAPER: Final = """\
A two-dimensional world is 600 wide and 600 high; x runs from left to right, y from bottom to top. The aim is to let the
ball fall into the abyss at the lower edge within 15 seconds. You can take blocks away at chosen times. Each object has
nine features. Blocks: x and y of the left end, x and y of the right end, radius, whether it can be eliminated, whether
it is dynamic, whether it belongs to a joint, whether to a spring. Balls: x, y, x, y, radius and the same four flags.
Blocks are 20 high. Flags are 0 or 1. Gravity acts on dynamic objects, some objects are static, and objects collide.
To do nothing is an action too. Answer with a list of actions and nothing else, each with a time in seconds and the
index of a block, 0 to 5, as in [{"time": 0, "index": 1}, {"time": 0.2, "index": 0}]. The objects are:
"""
_ASK: Final[dict[Strategy, str]] = {
    "in-advance": """\
Which blocks should go, and when? End your answer with a JSON list of objects in a fenced block. "time" is in seconds
from the start, 0 to 15 (0 is the first moment), "index" that of a block; each block at most once. Example of the form:
```json
[{"time": 0.4, "index": 1}, {"time": 2.5, "index": 0}]
```
The empty list [] removes nothing.""",
    "combined": """\
Which block should go next, and how long from now? End your answer with a JSON list of one object in a fenced block.
"time" is in seconds from now, "index" that of a block. You will be asked again after it has gone. Example of the form:
```json
[{"time": 0.4, "index": 1}]
```
The empty list [] means that nothing more goes.""",
    "on-the-fly": """\
Which blocks should go now? End your answer with a JSON list of objects in a fenced block, each with the "index" of a
block. You will be asked again in 0.5 s. Example of the form:
```json
[{"index": 1}]
```
The empty list [] waits.""",
}
_PICTURE: Final = "The picture shows the start; the numbers on the blocks are their indices.\n"
_FRAMES: Final = "Further pictures show, of each earlier attempt, five moments after its last removal.\n"
_EMPTY: Final = "(no text)"  # told as an empty reply, for some servers refuse empty messages
_AGAIN: Final = (
    "Your answer could not be read: {problem}. Answer again and end with the JSON list in the form asked for."
)


@dataclass(frozen=True)
class Prompt:
    """What is asked, by its base, its strategy and what is shown of earlier attempts.

    Attributes:
        base: "paper", "plain", "physics" or "picture".
        strategy: when is asked: all at once, after each removal, or every 0.5 s.
        shown: None, "outcome", "trajectory" (positions of the balls every 0.5 s) or "frames" (five pictures).

    Raises:
        ValueError: another word, or the paper's prompt with another strategy or feedback than its own; one line.
    """

    base: Base = "plain"
    strategy: Strategy = "in-advance"
    shown: Shown | None = None

    def __post_init__(self) -> None:
        check_option("prompt", self.base, BASES)
        check_option("strategy", self.strategy, STRATEGIES)
        if self.shown is not None:
            check_option("feedback", self.shown, SHOWN)
        if self.base == "paper" and (self.strategy != "in-advance" or self.shown is not None):
            raise ValueError("prompt: expected strategy in-advance and no feedback with paper, which knew no others")

    @property
    def name(self) -> str:
        """Base, strategy unless in advance, and feedback: "plain", "physics+combined", "plain+outcome"."""
        strategy = None if self.strategy == "in-advance" else self.strategy
        return "+".join(filter(None, (self.base, strategy, self.shown)))

    @property
    def form(self) -> ReplyForm:
        """The form of its replies."""
        return FORM_OF[self.strategy]

    @property
    def feedback(self) -> Feedback | None:
        """What the protocol of attempts must give the agent."""
        if self.shown in ("trajectory", "frames"):
            return "trajectory"
        return "outcome" if self.shown == "outcome" else None

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that it says about two games with a made-up past: of its texts and of how scenes are told."""
        said: list[list[Message]] = []
        for scene in map(load_scene, ("support", "pendulum")):
            poses = scene.start_poses
            blocks = len(scene.eliminable_blocks)
            past = [Attempt(np.linspace(0.5, blocks - 0.5, blocks), False, -25.0, 1, 15.0, np.tile(poses, (151, 1, 1)))]
            told = Prompt(self.base, self.strategy, "trajectory" if self.shown == "frames" else self.shown)
            said.append(told.conversation(scene, past, Moment(0.5, poses, poses), draw=False))
        if self.shown == "frames":
            said.append([Message("user", _PICTURE + _FRAMES)])  # the past of the two games is told in words
        told_text = json.dumps([[message[:2] for message in conversation] for conversation in said])
        return hashlib.sha256(json.dumps([self.name, VERSION, _AGAIN, told_text]).encode()).hexdigest()

    def conversation(
        self, scene: Scene, past: Sequence[Attempt] = (), moment: Moment | None = None, *, draw: bool = True
    ) -> list[Message]:
        """Return the conversation that asks for the next removals.

        Args:
            scene: the scene.
            past: earlier attempts, which are told if `shown` says so.
            moment: where the play stands; ignored in advance.
            draw: whether pictures are made, which needs the extra `viewer`.
        """
        if self.base == "paper":
            asked = _PAPER + descriptions.official_table(scene)
            return [Message("system", _PAPER_SYSTEM), Message("user", asked)]
        parts = [_RULES, _PHYSICS if self.base == "physics" else "", self._pictures_told(past)]
        parts += [descriptions.describe_scene(scene), "\n", self._past(scene, past), self._now(scene, moment)]
        pictures = self._pictures(scene, past) if draw else ()
        return [
            Message("system", _SYSTEM),
            Message("user", "".join(part for part in parts if part) + _ASK[self.strategy], pictures),
        ]

    def _past(self, scene: Scene, past: Sequence[Attempt]) -> str:
        if self.shown is None or not past:
            return ""
        positions = self.shown == "trajectory"
        told = (
            descriptions.describe_attempt(scene, attempt, number, positions=positions)
            for number, attempt in enumerate(past, 1)
        )
        return "Your earlier attempts at this game:\n" + "\n".join(told) + "\n"

    def _now(self, scene: Scene, moment: Moment | None) -> str:
        if self.strategy == "in-advance" or moment is None:
            return ""
        state = descriptions.describe_state(scene, moment.poses, moment.earlier, moment.rate)
        return f"{moment.seconds:.2f} s have passed in this attempt. Now:\n{state}\n"

    def _pictures_told(self, past: Sequence[Attempt]) -> str:
        if self.shown == "frames":
            return _PICTURE + _FRAMES if past else _PICTURE
        return _PICTURE if self.base == "picture" else ""

    def _pictures(self, scene: Scene, past: Sequence[Attempt]) -> tuple[bytes, ...]:
        if self.base != "picture" and self.shown != "frames":
            return ()
        from iphyre_jax.agents.language import pictures  # only here is the extra `viewer` needed

        told = past if self.shown == "frames" else ()
        return (pictures.start(scene), *(png for attempt in told for png in pictures.after_removals(scene, attempt)))


def again(conversation: Sequence[Message], reply: str, problem: str) -> list[Message]:
    """Return the conversation that asks once more after a reply that could not be read."""
    said = reply if reply.strip() else _EMPTY
    return [*conversation, Message("assistant", said), Message("user", _AGAIN.format(problem=problem))]

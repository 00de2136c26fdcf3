"""The agent: asks a language model for plans, as the protocol of `iphyre_jax.attempts` wants them.

It knows neither where answers come from nor how plans are scored: `ask` gives replies, `attempts` plays.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from iphyre_jax.agents.language.calls import Answer
from iphyre_jax.agents.language.prompts import Message, Moment, Prompt, again
from iphyre_jax.agents.language.replies import Parsed, Reason, Removal, parse_reply
from iphyre_jax.agents.language.transcripts import Question
from iphyre_jax.attempts.protocol import Attempt
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.rules import DECISIONS_PER_SECOND, TIME_LIMIT
from iphyre_jax.scenes import Scene
from iphyre_jax.simulation import simulate

Floats = npt.NDArray[np.float64]

RENEWED: Final = 2  # further questions after a reply that cannot be read
EVERY: Final = 0.5  # s between two questions on the fly
DECISIONS: Final = round(TIME_LIMIT / EVERY)  # such questions in an attempt
# s; far more than the rounding of a clock, far less than a step. A removal at 0 is entered so, hence takes place at the
# first frame after the start: at 0 the rule knows none.
FIRST: Final = 1e-6
DTYPE: Final = "float64"
CUT_OFF: Final = ("length", "max_tokens")  # why a reply ended, as the two kinds of servers say it
_ROUNDED: Final = 1e-6  # steps by which a product of seconds and rate may be too large

Ask = Callable[[Question, Scene, Sequence[Message]], Answer]


@dataclass
class Asked:
    """What one attempt asked and was answered.

    Attributes:
        questions: calls, the renewed ones included.
        unread: replies that could not be read.
        cut_off: replies that ended at the limit of tokens.
        no_answer: a question had no readable reply, so the attempt went on without removals.
        dropped: entries that were dropped, by reason.
        tokens_in: of the questions, as far as the server says.
        tokens_out: of the replies.
        seconds: that the calls took.
        times: (S,) s, the plan; NaN for never.
    """

    questions: int = 0
    unread: int = 0
    cut_off: int = 0
    no_answer: bool = False
    dropped: Counter[Reason] = field(default_factory=Counter)
    tokens_in: int = 0
    tokens_out: int = 0
    seconds: float = 0.0
    times: Floats = field(default_factory=lambda: np.empty(0))


class LanguageAgent:
    """Plays one sample of each game; an `Agent` of `iphyre_jax.attempts.attempts`.

    Args:
        prompt: what is asked.
        ask: gives the reply to a question; what it raises ends the run.
        sample: number of the sample, which goes into every question.
        fps: physics steps a second, those of the attempts.
        resets: number of the reset, that of the attempts.

    Attributes:
        asked: (game, attempt from 1 on) -> what was asked.
    """

    def __init__(self, prompt: Prompt, ask: Ask, sample: int, fps: int, resets: int) -> None:
        self.prompt, self._ask, self._sample = prompt, ask, sample
        self._fps, self._resets = fps, resets
        self.asked: dict[tuple[str, int], Asked] = {}

    def __call__(self, scene: Scene, k: int, rng: np.random.Generator, past: Sequence[Attempt]) -> Floats:
        """Return k plans, (k, S) s, NaN for never; each is asked for on its own."""
        del rng
        return np.stack([self._attempt(scene, past, len(past) + 1 + number) for number in range(k)])

    def _attempt(self, scene: Scene, past: Sequence[Attempt], number: int) -> Floats:
        """Ask for one plan."""
        log = self.asked[scene.name, number] = Asked()
        times = np.full(len(scene.eliminable_blocks), np.nan)
        if self.prompt.strategy == "in-advance":
            _enter(times, self._read(scene, past, number, None).removals)
        elif self.prompt.strategy == "combined":
            self._removal_by_removal(scene, past, number, times)
        else:
            self._on_the_fly(scene, past, number, times)
        log.times = times
        return times

    def _removal_by_removal(self, scene: Scene, past: Sequence[Attempt], number: int, times: Floats) -> None:
        """Ask for the next removal, at the start and after each."""
        seconds = 0.0
        while (
            seconds < TIME_LIMIT
            and np.isnan(times).any()
            and (moment := self._moment(scene, times, seconds)) is not None
        ):
            removals = self._read(scene, past, number, moment).removals
            if not removals:  # nothing more
                return
            seconds += removals[0].time
            _enter(times, [Removal(self._time(seconds), removals[0].slot)])

    def _on_the_fly(self, scene: Scene, past: Sequence[Attempt], number: int, times: Floats) -> None:
        """Ask every half second what goes now."""
        for decision in range(DECISIONS):
            seconds = decision * EVERY
            if not np.isnan(times).any() or (moment := self._moment(scene, times, seconds)) is None:
                return
            removals = self._read(scene, past, number, moment).removals
            now = self._time(seconds)
            _enter(times, [Removal(now, index) for _, index in removals])

    def _step(self, seconds: float) -> int:
        """The first step from so many seconds on."""
        return math.ceil(seconds * self._fps - _ROUNDED)

    def _time(self, seconds: float) -> float:
        """The time, s, of a removal at this very moment; a little early, for the clock adds up steps and is rounded."""
        return self._step(seconds) / self._fps - FIRST

    def _moment(self, scene: Scene, times: Floats, seconds: float) -> Moment | None:
        """Where the play stands after so many seconds; None if it has ended by then.

        Args:
            scene: that is played.
            times: (S,) s, of the removals until now, that of this moment included; NaN for the others.
            seconds: since the start.
        """
        step = self._step(seconds)
        played = simulate(
            scene,
            plan_to_steps(times[None], self._fps, "simulate"),
            fps=self._fps,
            resets=self._resets,
            dtype=DTYPE,
            duration=max(step, 1) / self._fps,
            sample_every=1,
        )
        if (played.success[0] or played.fault[0]) and played.steps[0] <= step:
            return None
        samples = played.samples
        assert samples is not None  # noqa: S101 - they were asked for
        poses = samples[0, step].copy()
        poses[np.array(scene.eliminable_blocks)[~np.isnan(times)]] = np.nan  # also what goes at this very moment
        span = max(min(step, self._fps // DECISIONS_PER_SECOND), 1)  # steps
        gone = frozenset(np.flatnonzero(~np.isnan(times)).tolist())
        return Moment(seconds, poses, samples[0, max(step - span, 0)], self._fps / span, gone)

    def _read(self, scene: Scene, past: Sequence[Attempt], number: int, moment: Moment | None) -> Parsed:
        """Ask until a reply can be read, three times at most; then nothing is removed."""
        log = self.asked[scene.name, number]
        conversation = self.prompt.conversation(scene, past, moment)
        left, gone = (TIME_LIMIT, frozenset()) if moment is None else (TIME_LIMIT - moment.seconds, moment.gone)
        for _ in range(1 + RENEWED):
            log.questions += 1
            answer = self._ask(Question(scene.name, self._sample, number, log.questions), scene, conversation)
            log.tokens_in += answer.tokens_in or 0
            log.tokens_out += answer.tokens_out or 0
            log.seconds += answer.seconds
            parsed = parse_reply(answer.reply, len(scene.eliminable_blocks), self.prompt.form, left, gone)
            log.cut_off += answer.finish in CUT_OFF
            log.dropped.update(parsed.dropped)
            if parsed.problem is None:
                return parsed
            log.unread += 1
            conversation = again(conversation, answer.reply, parsed.problem)
        log.no_answer = True
        return Parsed()


def _enter(times: Floats, removals: Sequence[Removal]) -> None:
    """Put removals into a plan; those at 0 take the first frames after the start.

    Of equal times a plan takes the lowest block first. So a removal is put behind those that were entered before it.
    """
    for time, index in removals:
        entered = max(time, FIRST)
        while (times == entered).any():
            entered = np.nextafter(entered, np.inf)
        times[index] = entered

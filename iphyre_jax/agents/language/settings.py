"""What decides a run, and how much it may ask."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from iphyre_jax.agents.language.agent import DECISIONS, DTYPE, RENEWED
from iphyre_jax.agents.language.calls import CallSettings
from iphyre_jax.agents.language.prompts import PHYSICS_FPS, VERSION, Base, Prompt, Shown, Strategy
from iphyre_jax.analyses.oracle import RESETS
from iphyre_jax.checks import check_whole, show
from iphyre_jax.scenes import GAMES, load_scene
from iphyre_jax.scenes.library import ALL_GAMES, hint

RATES: Final = (60, 10)
MOST_ATTEMPTS: Final = 100
MOST_SAMPLES: Final = 1000
_MOST_QUESTIONS: Final = 10**9
_MOST_TOKENS: Final = 10**12


@dataclass(frozen=True)
class RunSettings:
    """What decides a run, beside the model.

    Attributes:
        games: names of games.
        prompt: "paper", "plain", "physics" or "picture".
        strategy: "in-advance", "combined" or "on-the-fly".
        feedback: what is shown of earlier attempts: None, "outcome", "trajectory" or "frames".
        attempts: tries at each game.
        samples: how often the attempts are made.
        fps: 60 or 10 physics steps a second.
        call: what decides a reply beside the question.

    Raises:
        ValueError: one line that names the field.
    """

    games: tuple[str, ...] = GAMES
    prompt: Base = "plain"
    strategy: Strategy = "in-advance"
    feedback: Shown | None = "outcome"
    attempts: int = 2
    samples: int = 1
    fps: int = 60
    call: CallSettings = field(default_factory=CallSettings)

    def __post_init__(self) -> None:
        for game in self.games:
            if game not in ALL_GAMES:
                raise ValueError(f"games: expected games of the package, got {show(game)} ({hint(str(game))})")
        if not self.games or len(set(self.games)) < len(self.games):
            raise ValueError(f"games: expected each game once, and at least one, got {show(self.games)}")
        check_whole("attempts", self.attempts, 1, MOST_ATTEMPTS)
        check_whole("samples", self.samples, 1, MOST_SAMPLES)
        if check_whole("fps", self.fps) not in RATES:
            raise ValueError(f"fps: expected one of {', '.join(map(str, RATES))}, got {self.fps}")
        _ = self.asked  # its words are checked
        if self.prompt == "physics" and self.fps != PHYSICS_FPS:
            raise ValueError(f"fps: expected {PHYSICS_FPS} with the prompt physics, which states it, got {self.fps}")

    @cached_property
    def asked(self) -> Prompt:
        """The prompt."""
        return Prompt(self.prompt, self.strategy, self.feedback)

    @property
    def resets(self) -> int:
        """The reset of this rate: a fresh space at 60, that of the official environments at 10."""
        return RESETS[self.fps]

    def to_json(self) -> dict[str, Any]:
        """Return the settings as JSON values."""
        prompt = {"name": self.asked.name, "version": VERSION, "hash": self.asked.hash}
        return {
            "games": list(self.games),
            "prompt": prompt,
            "attempts": self.attempts,
            "samples": self.samples,
            "fps": self.fps,
            "resets": self.resets,
            "dtype": DTYPE,
            "parameters": parameters(self.call),
        }


def parameters(call: CallSettings) -> dict[str, Any]:
    """Return the settings of a call as JSON values."""
    return {
        "temperature": None if call.completion_tokens else call.temperature,
        "max_tokens": call.max_tokens,
        "completion_tokens": call.completion_tokens,
    }


@dataclass(frozen=True)
class Caps:
    """Bounds of a whole run, what it asked before it was resumed included.

    Attributes:
        questions: calls.
        tokens: of questions and replies, as far as the server counts them.
    """

    questions: int = 1000
    tokens: int = 2_000_000

    def __post_init__(self) -> None:
        check_whole("max_questions", self.questions, 1, _MOST_QUESTIONS)
        check_whole("max_tokens_in_all", self.tokens, 1, _MOST_TOKENS)


def most_questions(settings: RunSettings) -> int:
    """Return how many calls a run makes at most: replies may be unreadable, and some strategies ask often."""
    blocks = [len(load_scene(game).eliminable_blocks) for game in settings.games]
    each = {"in-advance": len(blocks), "combined": sum(blocks), "on-the-fly": DECISIONS * len(blocks)}
    return (1 + RENEWED) * settings.samples * settings.attempts * each[settings.strategy]

"""Runs: every game, sample and attempt asked and played; a run goes on where it stopped, from its transcript.

Plays are computed again, for they cost little and have the same bits; answers are never asked for twice. A call that
failed leaves no line, so that nothing is scored for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from iphyre_jax.agents.language.agent import DTYPE, Ask, Asked, LanguageAgent
from iphyre_jax.agents.language.replies import REASONS
from iphyre_jax.agents.language.settings import RunSettings
from iphyre_jax.analyses.orders import executed_order
from iphyre_jax.attempts.protocol import Attempts, attempts
from iphyre_jax.files import read_versioned, replace_json
from iphyre_jax.plans import plan_to_steps
from iphyre_jax.provenance import differences

SCHEMA: Final = "iphyre_jax/ask-run"
VERSION: Final = 1
FILE: Final = "run.json"


@dataclass(frozen=True)
class Ended:
    """What came of a run: the attempts of each sample, and what was asked in each."""

    played: tuple[Attempts, ...]
    asked: tuple[Mapping[tuple[str, int], Asked], ...]


def run(settings: RunSettings, ask: Ask) -> Ended:
    """Ask and play everything, sample after sample.

    Raises:
        CallFailedError, ValueError, OSError: what `ask` raises.
    """
    played, asked = [], []
    for sample in range(settings.samples):
        agent = LanguageAgent(settings.asked, ask, sample, settings.fps, settings.resets)
        played.append(
            attempts(
                agent,
                settings.attempts,
                feedback=settings.asked.feedback,
                games=settings.games,
                fps=settings.fps,
                resets=settings.resets,
                dtype=DTYPE,
            )
        )
        asked.append(agent.asked)
    return Ended(tuple(played), tuple(asked))


def rows_of(settings: RunSettings, ended: Ended) -> list[dict[str, Any]]:
    """Return one row of JSON values for each sample, game and attempt."""
    rows = []
    for sample, (played, asked) in enumerate(zip(ended.played, ended.asked, strict=True)):
        for row, game in enumerate(settings.games):
            for number in range(settings.attempts):
                log, at = asked[game, number + 1], (row, 0, number)
                steps = plan_to_steps(log.times[None], settings.fps, "simulate")[0]
                made = round(float(played.seconds[at]) * settings.fps)
                rows.append(
                    {
                        "game": game,
                        "sample": sample,
                        "attempt": number + 1,
                        "success": bool(played.success[at]),
                        "reward": float(played.reward[at]),
                        "seconds": float(played.seconds[at]),
                        "eliminations": int(played.eliminations[at]),
                        "plan": [None if np.isnan(time) else float(time) for time in log.times],
                        "order": list(executed_order(steps, made)),
                        "questions": log.questions,
                        "unread": log.unread,
                        "cut_off": log.cut_off,
                        "no_answer": log.no_answer,
                        "dropped": {reason: log.dropped[reason] for reason in REASONS},
                        "tokens_in": log.tokens_in,
                        "tokens_out": log.tokens_out,
                        "call_seconds": log.seconds,
                    }
                )
    return rows


def check_folder(folder: Path, settings: RunSettings, model: Mapping[str, str]) -> None:
    """Begin a run folder, or see that it holds a run of these settings and this model.

    Raises:
        ValueError: it holds another run; one line.
        OSError: it cannot be read or written.
    """
    content = {"schema": SCHEMA, "version": VERSION, "settings": settings.to_json(), "model": dict(model)}
    file = folder / FILE
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        replace_json(file, content)
        return
    found = read_versioned(file, SCHEMA, (VERSION,))
    for name, wanted in (("settings", settings.to_json()), ("model", model)):
        if found.get(name) != wanted:
            other = differences(found.get(name), wanted)
            raise ValueError(f"{file}: {name}: expected those of this run, got {other}; choose another folder")

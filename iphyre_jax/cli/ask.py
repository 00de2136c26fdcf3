"""`iphyre-jax ask`: a language model plays, live or from a transcript. Needs the extra `train`; live also `llm`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from iphyre_jax.agents.language import dialects, endpoints, report, runs, transcripts
from iphyre_jax.agents.language.answers import Live, Replay
from iphyre_jax.agents.language.calls import CallFailedError, CallSettings
from iphyre_jax.agents.language.prompts import Base, Shown, Strategy
from iphyre_jax.agents.language.settings import Caps, RunSettings, most_questions, parameters
from iphyre_jax.cli.console import option, refuse_unread
from iphyre_jax.cli.signals import resumable, until_signal
from iphyre_jax.files import check_apart, replace_json, replace_text
from iphyre_jax.locks import LOCK, lock_file, locked
from iphyre_jax.provenance import provenance
from iphyre_jax.scenes import GAMES
from iphyre_jax.scenes.library import GAME_LISTS
from iphyre_jax.train.reports.printing import say

ROWS_SCHEMA = "iphyre_jax/ask-rows"
TRANSCRIPT, ROWS = "transcript.jsonl", "rows.json"  # of a run folder
FAILED = 1  # exit code of a run that a failed call ended; it can go on


@dataclass(frozen=True)
class Ask:
    """Ask a language model for plans, play them and print a table beside doing nothing and random plans.

    The model: IPHYRE_JAX_LLM_URL, IPHYRE_JAX_LLM_MODEL, IPHYRE_JAX_LLM_KIND (openai or anthropic) and, if it asks for
    one, IPHYRE_JAX_LLM_KEY. A run that stopped goes on by the same command.
    """

    games: Annotated[
        tyro.conf.Positional[tuple[str, ...]], option("GAME ...", "Games or splits.", "all forty games")
    ] = ()
    prompt: Base = "plain"
    """What is told: the paper's information, the same put right, with physics, or with a picture."""
    strategy: Strategy = "in-advance"
    """When is asked: once, after each removal, or every 0.5 s."""
    feedback: Shown | None = "outcome"
    """What is shown of earlier attempts."""
    attempts: int = 2
    """Tries at each game."""
    samples: int = 1
    """How often the attempts are made; five are the least for a claim."""
    fps: int = 60
    """Physics steps a second: 60 or 10."""
    temperature: float = 0.5
    """Of the replies."""
    max_tokens: int = 2048
    """Of one reply."""
    completion_tokens: bool = False
    """Ask for max_completion_tokens and no temperature, as some models want."""
    max_questions: int = 1000
    """Cap on the calls of the run."""
    max_tokens_in_all: int = 2_000_000
    """Cap on the tokens of the run, questions and replies."""
    out: Path = Path("runs/ask")
    """Run folder of a live run."""
    record: Annotated[Path | None, option("FILE", "Where the transcript goes.", "transcript.jsonl in the folder")] = (
        None
    )
    replay: Annotated[
        tuple[Path, ...] | None,
        option("[FILE]", "Answer from a transcript; without a file, from the package's hand-written replies.", "live"),
    ] = None
    document: Annotated[Path | None, option("FILE", "Write the report there too.", "not written")] = None

    def settings(self) -> RunSettings:
        """Return what decides the run; errors in one line."""
        named = self.games or GAMES
        games = tuple(game for name in named for game in GAME_LISTS.get(name, (name,)))
        call = CallSettings(self.temperature, self.max_tokens, self.completion_tokens)
        return RunSettings(
            games, self.prompt, self.strategy, self.feedback, self.attempts, self.samples, self.fps, call
        )


def run(command: Ask, console: Console) -> int:
    """Run the command and return the exit code: 1 if a call failed, and the same command goes on.

    Raises:
        ValueError, OSError: one line.
    """
    if command.replay is not None and len(command.replay) > 1:
        raise ValueError(f"replay: expected one file, got {len(command.replay)}")
    if command.replay is not None:
        of_model = ("max_questions", "max_tokens_in_all", "out", "record")
        refuse_unread(command, {entry.name for entry in fields(command)} - {*of_model}, "with --replay")
    for file in (*(command.replay or ()), command.record, command.out / TRANSCRIPT, command.out / ROWS):
        check_apart("document", command.document, "the transcript and its rows", file)
    for name in (ROWS, runs.FILE):
        check_apart("record", command.record, name, command.out / name)
    settings = command.settings()
    answered = _live if command.replay is None else _replay
    try:
        work = partial(answered, command, settings, console)
        return resumable(work, console, "answer") if command.replay is None else until_signal(work)
    except CallFailedError as error:
        say(console, f"{error}\nNothing was scored for this call; the same command goes on from here.")
        return FAILED


def _replay(command: Ask, settings: RunSettings, console: Console) -> None:
    """Play what a transcript holds."""
    file = command.replay[0] if command.replay else transcripts.handwritten_file()
    answers = Replay(file, settings)
    rows = runs.rows_of(settings, runs.run(settings, answers))
    _print(command, settings, rows, answers.models, answers.parameters, console, handwritten=answers.handwritten)


def _live(command: Ask, settings: RunSettings, console: Console) -> None:
    """Ask a model."""
    endpoint = endpoints.from_environment(os.environ)
    endpoint.check(settings.call)
    dialects.package(endpoint.kind)
    caps = Caps(command.max_questions, command.max_tokens_in_all)
    tries = settings.samples * settings.attempts * len(settings.games)
    say(
        console,
        f"{endpoint.kind}: {endpoint.model}: {tries} attempts, "
        f"{most_questions(settings)} questions at most, "
        f"with replies of {settings.call.max_tokens} tokens at most; "
        f"the run ends at {caps.questions} questions or {caps.tokens} tokens",
    )
    model = {"kind": endpoint.kind, "model": endpoint.model}
    command.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        stack.enter_context(locked(command.out))
        runs.check_folder(command.out, settings, model)
        file = command.record or command.out / TRANSCRIPT
        file.parent.mkdir(parents=True, exist_ok=True)
        stack.enter_context(lock_file(file.with_name(f".{file.name}{LOCK}"), f"{file}: expected a transcript"))
        answers = Live(endpoint.complete, file, model, settings, caps, lambda line: say(console, line))
        rows = runs.rows_of(settings, runs.run(settings, answers))
        content = {"schema": ROWS_SCHEMA, "version": 1, "settings": settings.to_json(), "model": model, "rows": rows}
        replace_json(command.out / ROWS, {**content, "origin": provenance()})
    models, calls = [f"{endpoint.kind}: {endpoint.model}"], [parameters(settings.call)]
    _print(command, settings, rows, models, calls, console, handwritten=False)


def _print(
    command: Ask,
    settings: RunSettings,
    rows: list[dict[str, Any]],
    models: list[str],
    calls: Sequence[Mapping[str, Any]],
    console: Console,
    *,
    handwritten: bool,
) -> None:
    """Print the report, and write it if asked."""
    text = report.document(settings, rows, models, calls, handwritten=handwritten)
    say(console, text.rstrip())
    if command.document is not None:
        command.document.parent.mkdir(parents=True, exist_ok=True)
        replace_text(command.document, text)
        say(console, f"{command.document}")

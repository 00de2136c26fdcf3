"""Transcripts: one JSON line for each call, appended whole, so that a run can go on and a replay needs no network.

{"schema": "iphyre_jax/ask", "version": 1, "game": "hole", "scene": SHA-256 of the scene,
 "prompt": {"name": "plain", "version": 1, "hash": SHA-256}, "sample": 0, "attempt": 1, "question": 1,
 "kind": "openai", "model": "...", "parameters": {...},
 "messages": [{"role": "system", "text": "...", "pictures": [SHA-256, ...]}, ...] or null,
 "reply": "...", "finish": "stop", "usage": {"in": 900, "out": 60}, "seconds": 1.2, "time": "2026-11-23T03:00:00+00:00"}

A line of the kind "hand-written" was written by a person. It has no messages: it answers whatever the prompt asks about
that game.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any, Final, NamedTuple

from iphyre_jax.agents.language.calls import MAX_TOKENS, Answer
from iphyre_jax.agents.language.prompts import VERSION as PROMPT_VERSION
from iphyre_jax.agents.language.prompts import Message, Prompt
from iphyre_jax.agents.language.replies import MAX_READ
from iphyre_jax.checks import check_instance, check_whole, one_line, show
from iphyre_jax.data.dataset import scene_sum
from iphyre_jax.files import parse_json
from iphyre_jax.scenes import Scene
from iphyre_jax.viewer import line_files

SCHEMA: Final = "iphyre_jax/ask"
VERSION: Final = 1
# Bytes of a call: three replies of as many characters as are kept, twelve bytes for each at most, and the prompt.
MAX_LINE: Final = 3 * 12 * MAX_READ + 2_000_000
MOST_LINES: Final = 1_000_000
HANDWRITTEN: Final = "hand-written"  # the kind of lines that no model wrote

_BEGIN: Final = b'{"schema": "iphyre_jax/ask"'


class Question(NamedTuple):
    """Which call of a run it is."""

    game: str
    sample: int  # from 0
    attempt: int  # from 1
    number: int  # from 1, within the attempt

    def __str__(self) -> str:
        return f"{self.game}, sample {self.sample}, attempt {self.attempt}, question {self.number}"


class Entry(NamedTuple):
    """A line of a transcript, as far as a replay needs it."""

    prompt_hash: str
    scene_sum: str
    conversation: tuple[tuple[str, str], ...] | None  # role and text
    kind: str
    model: str
    parameters: Mapping[str, Any]  # of the call, see `settings.parameters`; empty if a person wrote the line
    answer: Answer


def line_of(
    question: Question,
    scene: Scene,
    prompt: Prompt,
    asked: Mapping[str, Any],
    conversation: Sequence[Message] | None,
    answer: Answer,
) -> dict[str, Any]:
    """Return the JSON of a call; `asked` holds kind, model and parameters. Nothing of it comes from the key."""
    return {
        "schema": SCHEMA,
        "version": VERSION,
        "game": question.game,
        "scene": scene_sum(scene),
        "prompt": {"name": prompt.name, "version": PROMPT_VERSION, "hash": prompt.hash},
        "sample": question.sample,
        "attempt": question.attempt,
        "question": question.number,
        **asked,
        "messages": None if conversation is None else [_message_json(message) for message in conversation],
        "reply": answer.reply,
        "finish": answer.finish,
        "usage": {"in": answer.tokens_in, "out": answer.tokens_out},
        "seconds": round(answer.seconds, 3),
        "time": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def append(path: Path, line: Mapping[str, Any]) -> None:
    """Append a call; it is on disk when this function returns.

    Raises:
        OSError: the file cannot be written.
        ValueError: the call is too long; one line.
    """
    line_files.append_line(path, json.dumps(line).encode(), _BEGIN, _is_whole, MAX_LINE)


def read(path: Path) -> dict[Question, Entry]:
    """Return the calls of a file; a torn last line, which nobody was told of, is no call.

    Raises:
        OSError: the file cannot be read.
        ValueError: a line is no call, or a question stands twice; one line that names the file and the line.
    """
    found: dict[Question, Entry] = {}
    for number, content in line_files.read_lines(path, MAX_LINE):
        where = f"{one_line(str(path))}: line {number}"
        if content is None or number > MOST_LINES:
            raise ValueError(f"{where}: expected at most {MOST_LINES} lines of at most {MAX_LINE} bytes")
        if not content.endswith(b"\n") and not _is_whole(content):
            break
        question, entry = _entry(content, where)
        if question in found:
            raise ValueError(f"{where}: expected a question once, got {question} again")
        found[question] = entry
    return found


def handwritten_file() -> Path:
    """Return the package's file of hand-written replies: no model's, and no measure of one."""
    return Path(str(files(__package__).joinpath("handwritten.jsonl")))


def matching(entry: Entry, question: Question, scene: Scene, prompt: Prompt, conversation: Sequence[Message]) -> Answer:
    """Return the answer of a recorded call if what was asked is what is asked now.

    Raises:
        ValueError: the prompt, the scene or the conversation is another one; one line naming the question.
    """
    for what, was, now in (
        ("prompt", entry.prompt_hash, prompt.hash),
        ("scene", entry.scene_sum, scene_sum(scene)),
        ("conversation", entry.conversation, tuple((message.role, message.text) for message in conversation)),
    ):
        if was is not None and was != now:
            raise ValueError(f"replay: {question}: expected the recorded {what}, got another one")
    return entry.answer


def _message_json(message: Message) -> dict[str, Any]:
    pictures = [hashlib.sha256(png).hexdigest() for png in message.pictures]
    return {"role": message.role, "text": message.text, "pictures": pictures}


def _is_whole(line: bytes) -> bool:
    try:
        return isinstance(parse_json(line, "line", MAX_LINE), dict)
    except ValueError:
        return False


def _entry(content: bytes, where: str) -> tuple[Question, Entry]:
    """Read one line."""
    line = parse_json(content, where, MAX_LINE)
    if not isinstance(line, dict) or line.get("schema") != SCHEMA or line.get("version") != VERSION:
        raise ValueError(f'{where}: expected schema "{SCHEMA}", version {VERSION}, got {show(line)}')
    prompt, usage = _field(line, "prompt", dict, where), _field(line, "usage", dict, where)
    question = Question(
        _field(line, "game", str, where),
        check_whole(f"{where}: sample", line.get("sample"), 0),
        check_whole(f"{where}: attempt", line.get("attempt")),
        check_whole(f"{where}: question", line.get("question")),
    )
    finish = line.get("finish")
    seconds = line.get("seconds")
    answer = Answer(
        _field(line, "reply", str, where),
        None if finish is None else check_instance(f"{where}: finish", finish, str, "text or null"),
        _tokens(usage.get("in"), f"{where}: usage.in"),
        _tokens(usage.get("out"), f"{where}: usage.out"),
        float(seconds) if isinstance(seconds, int | float) and 0 <= seconds < 1e9 else 0.0,
    )
    return question, Entry(
        _field(prompt, "hash", str, where),
        _field(line, "scene", str, where),
        _messages(line.get("messages"), where),
        _field(line, "kind", str, where),
        _field(line, "model", str, where),
        _field(line, "parameters", dict, where),
        answer,
    )


def _field(line: Mapping[str, Any], name: str, kind: type, where: str) -> Any:  # noqa: ANN401 - of that kind
    return check_instance(f"{where}: {name}", line.get(name), kind, "text" if kind is str else "an object")


def _tokens(value: object, name: str) -> int | None:
    return None if value is None else check_whole(name, value, 0, MAX_TOKENS * 100)


def _messages(value: object, where: str) -> tuple[tuple[str, str], ...] | None:
    if value is None:
        return None
    if not isinstance(value, list) or not all(isinstance(message, dict) for message in value):
        raise ValueError(f"{where}: messages: expected a list of objects or null, got {show(value)}")
    return tuple((_field(message, "role", str, where), _field(message, "text", str, where)) for message in value)

"""Transcripts: what is written is read again; damage is named; a replay answers only what was asked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from iphyre_jax.agents.language import transcripts
from iphyre_jax.agents.language.calls import Answer
from iphyre_jax.agents.language.prompts import Message, Prompt
from iphyre_jax.agents.language.transcripts import Question
from iphyre_jax.scenes import GAMES, load_scene

SCENE, PROMPT = load_scene("support"), Prompt("plain", "in-advance", "outcome")
MESSAGES = [Message("system", "play"), Message("user", "how? \ud800", (b"png",))]
ASKED = {"kind": "openai", "model": "tiny", "parameters": {}}
ANSWER = Answer("so [] \n\x00 \ud800 ü", "stop", 3, None, 1.25)
FIRST = Question("support", 0, 1, 1)


def line(question: Question = FIRST, answer: Answer = ANSWER) -> dict[str, Any]:
    return transcripts.line_of(question, SCENE, PROMPT, ASKED, MESSAGES, answer)


def test_calls_are_written_and_read(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    second = FIRST._replace(attempt=2)
    transcripts.append(file, line())
    transcripts.append(file, line(second))
    found = transcripts.read(file)
    assert list(found) == [FIRST, second]
    assert found[FIRST].answer == ANSWER
    assert transcripts.matching(found[FIRST], FIRST, SCENE, PROMPT, MESSAGES) == ANSWER
    assert file.read_bytes().startswith(transcripts._BEGIN)


@pytest.mark.parametrize("cut", [1, 40, -2])
def test_a_torn_line_is_no_call_and_the_next_one_takes_its_place(tmp_path: Path, cut: int) -> None:
    file = tmp_path / "a.jsonl"
    transcripts.append(file, line())
    whole = file.read_bytes()
    file.write_bytes(whole + whole[:cut])
    assert list(transcripts.read(file)) == [FIRST]
    with pytest.warns(RuntimeWarning, match="torn"):
        transcripts.append(file, line(FIRST._replace(sample=1)))
    assert list(transcripts.read(file)) == [FIRST, FIRST._replace(sample=1)]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"schema": "other"}, "line 1: expected schema"),
        ({"version": 2}, "line 1: expected schema"),
        ({"game": 3}, "line 1: game: expected text"),
        ({"sample": -1}, "line 1: sample: expected a whole number"),
        ({"attempt": True}, "line 1: attempt: expected a whole number"),
        ({"question": None}, "line 1: question: expected a whole number"),
        ({"reply": None}, "line 1: reply: expected text"),
        ({"messages": "no"}, "line 1: messages: expected a list"),
        ({"messages": [{"role": 1}]}, "line 1: role: expected text"),
        ({"usage": []}, "line 1: usage: expected an object"),
        ({"usage": {"in": "many"}}, "line 1: usage.in: expected a whole number"),
        ({"prompt": {}}, "line 1: hash: expected text"),
        ({"finish": 1}, "line 1: finish: expected text or null"),
    ],
)
def test_a_line_that_is_no_call_is_named(tmp_path: Path, changed: dict[str, Any], message: str) -> None:
    file = tmp_path / "a.jsonl"
    file.write_text(json.dumps({**line(), **changed}) + "\n")
    with pytest.raises(ValueError) as caught:
        transcripts.read(file)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_question_stands_once(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    transcripts.append(file, line())
    transcripts.append(file, line())
    with pytest.raises(ValueError, match=r"line 2: expected a question once, got support, sample 0, attempt 1"):
        transcripts.read(file)


def test_what_was_not_asked_is_not_answered(tmp_path: Path) -> None:
    transcripts.append(tmp_path / "a.jsonl", line())
    entry = transcripts.read(tmp_path / "a.jsonl")[FIRST]
    others = [
        ("prompt", SCENE, Prompt("physics"), MESSAGES),
        ("scene", load_scene("hinder"), PROMPT, MESSAGES),
        ("conversation", SCENE, PROMPT, MESSAGES[:1]),
    ]
    for what, scene, prompt, conversation in others:
        with pytest.raises(ValueError, match=rf"^replay: support, .* question 1: expected the recorded {what}, got an"):
            transcripts.matching(entry, FIRST, scene, prompt, conversation)


def test_the_hand_written_replies_are_of_all_games_and_of_the_present_prompt() -> None:
    found = transcripts.read(transcripts.handwritten_file())
    assert {(question.game, question.attempt) for question in found} == {(g, a) for g in GAMES for a in (1, 2)}
    for question, entry in found.items():
        assert entry.kind == transcripts.HANDWRITTEN
        assert transcripts.matching(entry, question, load_scene(question.game), PROMPT, []) == entry.answer

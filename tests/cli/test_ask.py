"""`iphyre-jax ask`: from recorded replies without a network, and live against what stands in for a server."""

from __future__ import annotations

import json
import os
import re
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import tyro

from iphyre_jax.agents.language.calls import Answer, CallFailedError, CallSettings
from iphyre_jax.agents.language.endpoints import NOT_CONFIGURED, Endpoint
from iphyre_jax.agents.language.prompts import Message
from iphyre_jax.cli import ask
from iphyre_jax.cli.main import run

KEY = "sk-a-very-secret-key-0123456789"


@pytest.fixture(autouse=True)
def no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise AssertionError("a connection was made")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    for name in ("URL", "MODEL", "KEY", "KIND"):
        monkeypatch.delenv(f"IPHYRE_JAX_LLM_{name}", raising=False)


def configure(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"URL": "https://models.example/v1", "MODEL": "tiny", "KEY": KEY}.items():
        monkeypatch.setenv(f"IPHYRE_JAX_LLM_{name}", value)


def test_nothing_configured_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ask"]) == 2
    printed = capsys.readouterr()
    assert printed.err == f"iphyre-jax: {NOT_CONFIGURED}\n"
    assert printed.out == ""


def cells(out: str, name: str) -> list[str]:
    (line,) = [line for line in out.splitlines() if line.startswith(f"| {name} ")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_hand_written_replies_make_a_table(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Played in earnest, in one game: the bounds stand beside, and no model is named."""
    document = tmp_path / "language.md"
    assert run(["ask", "support", "--replay", "--document", str(document)]) == 0
    out = capsys.readouterr().out
    assert "**These replies were written by hand**" in out
    assert float(cells(out, "hand-written replies, first attempt")[1].split()[0]) > 970
    assert cells(out, "do nothing, best of 2")[1].startswith("-15.0")
    assert cells(out, "support")[1] == "100 %"
    assert cells(out, "all played")[1:] == ["2", "0", "0", "0", "0"]  # sources of failure: both attempts solved
    assert re.search(r'"hash": "[0-9a-f]{64}"', document.read_text("utf-8"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--replay", "missing.jsonl"], "missing.jsonl"),
        (["--replay", "a", "b"], "replay: expected one file, got 2"),
        (["nowhere", "--replay"], "games: expected games of the package, got 'nowhere' (iphyre_jax.GAMES lists them)"),
        (["support", "--replay", "--fps", "30"], "fps: expected one of 60, 10"),
        (["support", "--replay", "--prompt", "physics"], "replay: support, sample 0, attempt 1, question 1: expected"),
        (["support", "--replay", "--attempts", "0"], "attempts: expected a whole number"),
        (["support", "--replay", "--record", "a.jsonl"], "record: expected none with --replay, got 'a.jsonl'"),
    ],
)
def test_a_mistake_gets_one_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["ask", *arguments]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["openai", "anthropic"])
def test_a_missing_package_is_named_with_its_extra(
    kind: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configure(monkeypatch)
    monkeypatch.setenv("IPHYRE_JAX_LLM_KIND", kind)
    monkeypatch.setitem(sys.modules, kind, None)
    assert run(["ask", "support", "--out", str(tmp_path / "run")]) == 2
    message = f"this command needs the extra 'llm' ({kind} is missing): pip install 'iphyre-jax[llm]'"
    assert capsys.readouterr().err == f"iphyre-jax: {message}\n"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], ("plain", "in-advance", "outcome")),
        (["--prompt", "paper", "--feedback", "None"], ("paper", "in-advance", None)),
        (["--strategy", "combined", "--feedback", "frames"], ("plain", "combined", "frames")),
    ],
)
def test_the_prompt_is_chosen_by_words(words: list[str], expected: tuple[str, str, str | None]) -> None:
    asked = tyro.cli(ask.Ask, args=["basic", *words]).settings().asked
    assert (asked.base, asked.strategy, asked.shown) == expected


def test_a_live_run_is_recorded_goes_on_and_keeps_the_key_to_itself(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configure(monkeypatch)
    replies: list[str | Exception] = ["hm", CallFailedError("llm: the call failed (status 500): gone", 500)]
    heard: list[Endpoint] = []

    def complete(self: Endpoint, conversation: Sequence[Message], settings: CallSettings) -> Answer:
        heard.append(self)
        reply = replies.pop(0)
        if isinstance(reply, Exception):
            raise reply
        return Answer(reply, "stop", 100, 10, 0.5)

    monkeypatch.setattr(Endpoint, "complete", complete)
    monkeypatch.setitem(sys.modules, "openai", ModuleType("openai"))
    monkeypatch.setattr("iphyre_jax.agents.language.report.bounds", lambda settings: {})
    command = ["ask", "support", "--attempts", "1", "--out", str(tmp_path / "run")]
    assert run(command) == 1
    first = capsys.readouterr().out
    assert "openai: tiny: 1 attempts, 3 questions at most, with replies of 2048 tokens at most; the run ends" in first
    assert "Nothing was scored for this call; the same command goes on from here." in first
    assert not (tmp_path / "run" / "rows.json").exists()
    replies.append('[{"time": 0.1, "index": 0}, {"time": 0.2, "index": 1}]')
    assert run(command) == 0
    out = capsys.readouterr().out
    assert len(heard) == 3
    assert heard[0].key == KEY
    assert cells(out, "readable replies")[1] == "50.0 %"
    rows: list[dict[str, Any]] = json.loads((tmp_path / "run" / "rows.json").read_text())["rows"]
    assert [(row["success"], row["questions"]) for row in rows] == [(True, 2)]
    transcript = tmp_path / "run" / "transcript.jsonl"
    assert run(["ask", "support", "--attempts", "1", "--replay", str(transcript)]) == 0
    again = capsys.readouterr().out
    assert cells(again, "support") == cells(out, "support")
    written = [file.read_text("utf-8") for file in (tmp_path / "run").iterdir()]
    assert len(written) == 3
    assert KEY not in "".join([first, out, again, *written])


def test_a_transcript_is_of_one_run_at_a_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two run folders may name the same file: the second run is refused while the first one holds it."""
    configure(monkeypatch)
    record, said = tmp_path / "record.jsonl", []

    def complete(self: Endpoint, conversation: Sequence[Message], settings: CallSettings) -> Answer:
        if not said:
            said.append("refused before it asks")
            assert run(["ask", "hole", "--attempts", "1", "--out", str(tmp_path / "b"), "--record", str(record)]) == 2
            said.append(capsys.readouterr().err)
        return Answer("[]", "stop", 100, 10, 0.5)

    monkeypatch.setattr(Endpoint, "complete", complete)
    monkeypatch.setitem(sys.modules, "openai", ModuleType("openai"))
    monkeypatch.setattr("iphyre_jax.agents.language.report.bounds", lambda settings: {})
    assert run(["ask", "support", "--attempts", "1", "--out", str(tmp_path / "a"), "--record", str(record)]) == 0
    message = f"iphyre-jax: {record}: expected a transcript that nobody uses, but process {os.getpid()} on "
    assert said[1].startswith(message)
    assert len(record.read_text().splitlines()) == 1
    assert {file.name for file in tmp_path.iterdir()} == {"a", "b", "record.jsonl"}


def test_a_temperature_that_the_kind_does_not_know_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    configure(monkeypatch)
    monkeypatch.setenv("IPHYRE_JAX_LLM_KIND", "anthropic")
    assert run(["ask", "support", "--temperature", "1.5", "--out", str(tmp_path / "run")]) == 2
    message = "temperature: expected a temperature for anthropic of at least 0 and at most 1, got 1.5"
    assert capsys.readouterr().err == f"iphyre-jax: {message}\n"
    assert not list(tmp_path.iterdir())


def test_a_document_never_replaces_a_transcript(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    transcript = tmp_path / "transcript.jsonl"
    transcript.write_bytes(ask.transcripts.handwritten_file().read_bytes())
    before = transcript.read_bytes()
    configure(monkeypatch)
    for options in (
        ["--replay", str(transcript)],
        ["--record", str(transcript)],
        ["--out", str(tmp_path)],
    ):
        assert run(["ask", "support", *options, "--document", str(tmp_path / "." / "transcript.jsonl")]) == 2
        message = capsys.readouterr().err
        assert message.startswith("iphyre-jax: document: expected another file than the transcript and its rows, got")
        assert transcript.read_bytes() == before


def test_a_transcript_is_not_written_over_by_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    configure(monkeypatch)
    for name in ("rows.json", "run.json"):
        assert run(["ask", "support", "--out", str(tmp_path), "--record", str(tmp_path / name)]) == 2
        assert capsys.readouterr().err.startswith(f"iphyre-jax: record: expected another file than {name}, got")
    assert not list(tmp_path.iterdir())

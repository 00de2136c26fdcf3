"""The official packages against the test server: `make test-llm`. Each fault leaves a run that goes on.

Here an answer is played in one game, by a stand-in for the physics, for what is tested is the calls.
"""

from __future__ import annotations

import base64
import json
import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from iphyre_jax.agents.language import calls, transcripts
from iphyre_jax.agents.language.answers import Live
from iphyre_jax.agents.language.calls import HIDDEN, CallFailedError, CallSettings
from iphyre_jax.agents.language.endpoints import KINDS, Endpoint
from iphyre_jax.agents.language.prompts import Message
from iphyre_jax.agents.language.replies import MAX_READ, parse_reply
from iphyre_jax.agents.language.settings import Caps, RunSettings
from iphyre_jax.agents.language.transcripts import Question
from iphyre_jax.scenes import load_scene
from tests.agents.language.language_server import REPLY, LanguageServer, serving

pytest.importorskip("openai", reason="make test-llm has the packages")
pytest.importorskip("anthropic", reason="make test-llm has the packages")

KEY = "sk-a-very-secret-key-0123456789"
SETTINGS = RunSettings(games=("support",), attempts=1, feedback=None)
PICTURE = b"a picture"
QUESTION = Question("support", 0, 1, 1)
MESSAGES = [Message("system", "You play."), Message("user", "What now?", (PICTURE,))]


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[LanguageServer]:
    monkeypatch.setattr(calls, "FIRST_WAIT", 0.01)
    for name in ("OPENAI_API_KEY", "OPENAI_ORG_ID", "OPENAI_ADMIN_KEY", "ANTHROPIC_API_KEY", "ANTHROPIC_AUTH_TOKEN"):
        monkeypatch.setenv(name, "foreign-secret-of-the-user")
    monkeypatch.setenv("ANTHROPIC_CUSTOM_HEADERS", "x-more: foreign-secret-of-the-user\nx-api-key: foreign-secret")
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    with serving() as served:
        yield served


def endpoint(server: LanguageServer, kind: str, key: str | None = KEY, limit: float = 30.0) -> Endpoint:
    return Endpoint(kind, server.url + ("/v1" if kind == "openai" else ""), "tiny", key, limit)


@pytest.mark.parametrize("kind", KINDS)
def test_a_question_is_put_as_the_dialect_wants_it(server: LanguageServer, kind: str) -> None:
    answer = endpoint(server, kind).complete(MESSAGES, CallSettings(0.25, 77))
    assert parse_reply(answer.reply, 2).removals == ((0.1, 0), (0.2, 1))
    assert (answer.tokens_in, answer.tokens_out) == (30, 12)
    (seen,) = server.seen
    body = seen["body"]
    assert (body["model"], body["temperature"], body["max_tokens"]) == ("tiny", 0.25, 77)
    told = json.dumps(body)
    assert "What now?" in told
    assert base64.b64encode(PICTURE).decode() in told
    if kind == "openai":
        assert seen["path"] == "/v1/chat/completions"
        assert seen["headers"]["authorization"] == f"Bearer {KEY}"
        assert body["messages"][0] == {"role": "system", "content": "You play."}
    else:
        assert seen["path"] == "/v1/messages"
        keys = [seen["headers"].get("x-api-key"), seen["headers"].get("authorization")]  # by version of the package
        assert keys in ([KEY, None], [None, f"Bearer {KEY}"])
        assert seen["headers"]["anthropic-version"]
        assert body["system"] == "You play."


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_but_the_key_given_is_sent(server: LanguageServer, kind: str) -> None:
    endpoint(server, kind).complete(MESSAGES, CallSettings())
    endpoint(server, kind, None).complete(MESSAGES, CallSettings())
    assert "foreign-secret" not in json.dumps(server.seen)
    assert not {"authorization", "x-api-key"} & set(server.seen[1]["headers"])


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_without_temperature(server: LanguageServer, kind: str) -> None:
    endpoint(server, kind).complete(MESSAGES, CallSettings(0.25, 77, completion_tokens=True))
    body = server.seen[0]["body"]
    assert "temperature" not in body
    assert body["max_completion_tokens" if kind == "openai" else "max_tokens"] == 77


@pytest.mark.parametrize("kind", KINDS)
def test_a_busy_server_is_asked_again(server: LanguageServer, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    server.faults = ["429", "500", "429"]
    assert endpoint(server, kind).complete(MESSAGES, CallSettings()).finish
    assert len(server.seen) == 4
    server.faults = ["500"] * 9
    with pytest.raises(CallFailedError, match="status 500"):
        endpoint(server, kind).complete(MESSAGES, CallSettings())
    assert len(server.seen) == 4 + 6


FAULTS = ["401", "slow", "dripping", "cut", "no JSON", "other JSON", "a page", "redirect", "gone"]
FAULTS += ["an error inside", "no answer inside", "a stream"]
SAID = {
    "other JSON": "got None",
    "a page": "got <html>log in</html>",
    "an error inside": "got overloaded ",
    "no answer inside": "got a list of 0",
    "a stream": "got data: [DONE]",
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_leaves_a_run_that_goes_on(
    server: LanguageServer, kind: str, fault: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    file, scene, model = tmp_path / "transcript.jsonl", load_scene("support"), {"kind": kind, "model": "tiny"}
    conversation = SETTINGS.asked.conversation(scene)
    limit = 0.4 if fault in ("slow", "dripping") else 30.0
    asked = endpoint(server, kind, KEY, limit)
    if fault == "gone":
        asked = Endpoint(kind, "http://127.0.0.1:9/v1", "tiny", KEY, 10.0)
    server.faults = [fault]
    with pytest.raises(CallFailedError) as caught:
        Live(asked.complete, file, model, SETTINGS, Caps())(QUESTION, scene, conversation)
    assert str(caught.value).startswith("llm: ")
    assert "\n" not in str(caught.value)
    if fault in SAID:
        what = ("choices", SAID[fault]) if kind == "openai" else ("content", SAID[fault].replace("a list of 0", "None"))
        assert f"expected an answer with {', '.join(what)}" in str(caught.value)
    assert not file.exists()  # nothing to score
    assert all(seen["path"] != "/elsewhere" for seen in server.seen)
    answer = Live(endpoint(server, kind).complete, file, model, SETTINGS, Caps())(QUESTION, scene, conversation)
    assert transcripts.read(file)[QUESTION].answer.reply == answer.reply
    chain: BaseException | None = caught.value
    while chain is not None:  # what a traceback would print
        assert KEY not in repr(chain) + str(chain)
        chain = chain.__cause__ or (None if chain.__suppress_context__ else chain.__context__)
    told = file.read_text() + caplog.text + repr(asked) + str(vars(caught.value))
    assert KEY not in told


@pytest.mark.parametrize("kind", KINDS)
def test_nonsense_beside_an_answer_does_not_spoil_it(server: LanguageServer, kind: str, tmp_path: Path) -> None:
    server.faults = ["odd"]
    file, scene, model = tmp_path / "transcript.jsonl", load_scene("support"), {"kind": kind, "model": "tiny"}
    asked = Live(endpoint(server, kind).complete, file, model, SETTINGS, Caps())
    answer = asked(QUESTION, scene, SETTINGS.asked.conversation(scene))
    assert (answer.finish, answer.tokens_in, answer.tokens_out) == (None, None, None)
    assert len(answer.reply) == MAX_READ
    assert len(parse_reply(answer.reply, 2).removals) == 2
    assert transcripts.read(file)[QUESTION].answer.reply == answer.reply


@pytest.mark.parametrize("kind", KINDS)
def test_replies_of_parts_of_halves_and_of_nothing_are_replies(server: LanguageServer, kind: str) -> None:
    server.faults = ["parts", "half a character", "nothing"]
    replies = [endpoint(server, kind).complete(MESSAGES, CallSettings()).reply for _ in range(3)]
    assert replies == [REPLY, f"so ? {REPLY}", ""]


@pytest.mark.parametrize("kind", KINDS)
def test_the_key_is_hidden_before_the_end_of_an_answer_is_cut(server: LanguageServer, kind: str) -> None:
    server.faults = ["the key at the end"]
    assert endpoint(server, kind).complete(MESSAGES, CallSettings()).finish == "x" * 75 + HIDDEN


def test_a_temperature_that_a_kind_does_not_know_is_refused_and_none_is_changed(server: LanguageServer) -> None:
    warm = CallSettings(1.5)
    with pytest.raises(
        ValueError, match=r"^temperature: expected a temperature for anthropic of .* at most 1, got 1.5$"
    ):
        endpoint(server, "anthropic").complete(MESSAGES, warm)
    assert not server.seen
    endpoint(server, "openai").complete(MESSAGES, warm)
    endpoint(server, "anthropic").complete(MESSAGES, CallSettings(1.5, completion_tokens=True))
    assert [seen["body"].get("temperature") for seen in server.seen] == [1.5, None]


@pytest.mark.parametrize("kind", KINDS)
def test_a_server_that_sends_the_key_back_does_not_bring_it_into_a_record(server: LanguageServer, kind: str) -> None:
    server.faults = ["echo"]
    answer = endpoint(server, kind).complete(MESSAGES, CallSettings())
    assert HIDDEN in answer.reply
    assert KEY not in repr(answer)

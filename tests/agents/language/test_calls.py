"""Calls without the packages: patience, limits, addresses, and that no error names the key."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime

import pytest

from iphyre_jax.agents.language import endpoints
from iphyre_jax.agents.language.calls import (
    HIDDEN,
    MAX_ERROR,
    RETRIES,
    Answer,
    CallFailedError,
    CallSettings,
    with_patience,
    within,
    without_key,
)
from iphyre_jax.agents.language.endpoints import NOT_CONFIGURED, Endpoint, from_environment

KEY = "sk-a-very-secret-key-0123456789"
URL = "https://models.example/v1"


def failing(*errors: Exception) -> tuple[Callable[[], Answer], list[float]]:
    left, waits = list(errors), []

    def call() -> Answer:
        if left:
            raise left.pop(0)
        return Answer("yes", "stop", 1, 1)

    return call, waits


def test_it_waits_as_the_server_asks_or_twice_as_long_each_time() -> None:
    errors = [CallFailedError("x", 500), CallFailedError("x", 429, 7.5), CallFailedError("x", 503)]
    call, waits = failing(*errors)
    assert with_patience(call, waits.append).reply == "yes"
    assert waits == [1.0, 7.5, 4.0]


def test_patience_ends() -> None:
    call, waits = failing(*[CallFailedError("busy", 429) for _ in range(9)])
    with pytest.raises(CallFailedError, match="busy"):
        with_patience(call, waits.append)
    assert waits == [1.0, 2.0, 4.0, 8.0, 16.0]
    assert len(waits) == RETRIES


@pytest.mark.parametrize(
    "error",
    [CallFailedError("x", 401), CallFailedError("x"), CallFailedError("x", 307), CallFailedError("x", 429, 1e6)],
)
def test_what_does_not_pass_is_not_tried_again(error: CallFailedError) -> None:
    call, waits = failing(error)
    with pytest.raises(CallFailedError):
        with_patience(call, waits.append)
    assert waits == []


def test_a_wait_that_is_too_long_is_named() -> None:
    call, waits = failing(CallFailedError("llm: busy", 429, 500.0))
    with pytest.raises(CallFailedError, match=r"^llm: the server asks to wait for 500 s, more than 120 s: llm: busy$"):
        with_patience(call, waits.append)
    assert waits == []


def test_a_call_ends_at_its_limit() -> None:
    never = threading.Event()

    def call() -> Answer:
        never.wait(30)
        return Answer("late", None, None, None)

    with pytest.raises(CallFailedError, match=r"^llm: expected an answer within 0.05 s, got none$"):
        within(0.05, call)
    never.set()
    assert within(30, lambda: Answer("soon", None, None, None)).seconds >= 0


def test_errors_are_one_short_line() -> None:
    assert str(CallFailedError("a\nb")) == "a\\nb"
    assert len(str(CallFailedError("x" * 10_000))) == MAX_ERROR


def test_the_key_is_hidden_and_a_placeholder_is_not() -> None:
    assert without_key(f"({KEY})", KEY) == f"({HIDDEN})"
    assert without_key("no ollama here", "ollama") == "no ollama here"
    assert without_key("text", None) == "text"


class ServerError(Exception):
    """As the packages raise them: with the response, and with what the server sent."""

    def __init__(self, text: str, status: int, headers: dict[str, str]) -> None:
        super().__init__(text)
        self.response = type("Response", (), {"status_code": status, "headers": headers})()


def test_no_error_of_a_package_brings_the_key_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def kind(endpoint: Endpoint, conversation: object, settings: object) -> Callable[[], Answer]:
        def ask() -> Answer:
            raise ServerError(f"bad key {endpoint.key}", 401, {})

        return ask

    monkeypatch.setitem(endpoints.CALLS, "openai", kind)
    endpoint = Endpoint("openai", URL, "tiny", KEY)
    with pytest.raises(CallFailedError) as caught:
        endpoint.complete([], CallSettings())
    assert str(caught.value) == f"llm: the call failed (status 401): bad key {HIDDEN}"
    assert caught.value.__context__ is None
    assert KEY not in repr(endpoint)


@pytest.mark.parametrize(("said", "wait"), [("3", 3.0), ("0.5", 0.5), ("-1", None), ("nan", None), ("soon", None)])
def test_the_wait_of_a_server_is_read(said: str, wait: float | None) -> None:
    assert endpoints._wait(ServerError("", 429, {"retry-after": said}).response) == wait
    assert endpoints._wait(None) is None


def test_a_wait_until_a_date_is_read() -> None:
    def wait(date: datetime) -> float | None:
        return endpoints._wait(ServerError("", 429, {"retry-after": format_datetime(date, usegmt=True)}).response)

    now = datetime.now(UTC)
    assert wait(now + timedelta(hours=1)) == pytest.approx(3600, abs=60)
    assert wait(now - timedelta(hours=1)) == 0.0


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in endpoints.KINDS:
        monkeypatch.setitem(sys.modules, kind, None)
        with pytest.raises(ModuleNotFoundError, match=r"needs the extra 'llm' .* pip install 'iphyre-jax\[llm\]'$"):
            Endpoint(kind, URL, "tiny").complete([], CallSettings())


def environment(**given: str) -> dict[str, str]:
    return {f"IPHYRE_JAX_LLM_{name}": value for name, value in given.items()}


def test_the_environment_names_the_endpoint() -> None:
    found = from_environment(environment(URL=URL, MODEL="m", KEY=f" {KEY}\n", KIND="anthropic"))
    assert found == Endpoint("anthropic", URL, "m", KEY)
    assert from_environment(environment(URL="http://localhost:8000/v1", MODEL="m")).key is None


@pytest.mark.parametrize("given", [{}, {"URL": URL}, {"MODEL": "m"}, {"URL": " ", "MODEL": "m"}, {"KEY": KEY}])
def test_what_is_not_configured_is_one_line(given: dict[str, str]) -> None:
    with pytest.raises(ValueError) as caught:
        from_environment(environment(**given))
    assert str(caught.value) == NOT_CONFIGURED


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"URL": "http://models.example/v1"}, "URL: expected https, for the host is not this machine"),
        ({"URL": "http://127.0.0.1.example/v1"}, "URL: expected https"),
        ({"URL": "ftp://localhost/"}, "URL: expected https"),
        ({"URL": f"https://user:{KEY}@models.example/"}, "URL: expected a URL such as https://host/v1, without user"),
        ({"URL": f"https://models.example/?key={KEY}"}, "URL: expected a URL such as https://host/v1, without user"),
        ({"URL": "https://"}, "URL: expected a URL"),
        ({"URL": "https://[::1"}, "URL: expected a URL"),
        ({"URL": "https://a:b/"}, "URL: expected a URL"),
        ({"KIND": "grpc"}, "KIND: expected one of openai, anthropic"),
        ({"MODEL": "a\nb"}, "MODEL: expected the name of a model"),
        ({"MODEL": KEY}, "KEY: expected printable ASCII"),
        ({"KEY": "two words"}, "KEY: expected printable ASCII"),
        ({"KEY": "schlüssel"}, "KEY: expected printable ASCII"),
        *(({"KEY": f"a-key-with-{sign}"}, "KEY: expected printable ASCII") for sign in "\\'\""),
    ],
)
def test_a_wrong_variable_is_named_without_the_key(given: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError) as caught:
        from_environment(environment(**{"URL": URL, "MODEL": "m", "KEY": KEY, **given}))
    said = str(caught.value)
    assert said.startswith(f"IPHYRE_JAX_LLM_{message}")
    assert "\n" not in said
    assert given.get("KEY", KEY) not in said

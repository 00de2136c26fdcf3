"""Endpoints: where language models answer. Two kinds, through the official packages, which are imported when called.

"openai" is any server that takes POST <url>/chat/completions, hosted or local; "anthropic" takes POST
<url>/v1/messages. The key comes from the environment alone and goes to that server alone: no redirect is followed, and
beyond this machine only https is used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, Final, Literal, get_args
from urllib.parse import urlsplit

from iphyre_jax.agents.language.calls import (
    LIMIT,
    Answer,
    CallFailedError,
    CallSettings,
    with_patience,
    within,
    without_key,
)
from iphyre_jax.agents.language.dialects import CALLS, is_local
from iphyre_jax.agents.language.prompts import Message
from iphyre_jax.agents.language.replies import MAX_READ
from iphyre_jax.checks import check_least, check_option, one_line, show

Dialect = Literal["openai", "anthropic"]
KINDS: Final[tuple[Dialect, ...]] = get_args(Dialect)
WARMEST: Final[dict[str, float]] = {"openai": 2.0, "anthropic": 1.0}  # temperature
MAX_WORD: Final = 100  # characters that say why a reply ended
VARIABLE: Final = "IPHYRE_JAX_LLM_"
NOT_CONFIGURED: Final = (
    "llm: no endpoint: set IPHYRE_JAX_LLM_URL and IPHYRE_JAX_LLM_MODEL (IPHYRE_JAX_LLM_KEY if it asks for one), "
    "or give --replay FILE"
)


@dataclass(frozen=True)
class Endpoint:
    """A model on a server; its key is in no text of it.

    Attributes:
        kind: "openai" or "anthropic".
        url: of the server: https, or http on this machine.
        model: its name there.
        key: sent to the server alone; None if it asks for none.
        limit: s, of one call.

    Raises:
        ValueError: one line that names the variable.
    """

    kind: str
    url: str
    model: str
    key: str | None = field(default=None, repr=False)
    limit: float = LIMIT

    def __post_init__(self) -> None:
        check_option(f"{VARIABLE}KIND", self.kind, KINDS)
        check_url(f"{VARIABLE}URL", self.url)
        if not self.model or self.model != one_line(self.model):
            raise ValueError(f"{VARIABLE}MODEL: expected the name of a model, got {show(self.model)}")
        if self.key is not None and (self.key in self.model or not _is_header(self.key)):
            what = "printable ASCII without spaces, quotes and backslashes, and another text than the model"
            raise ValueError(f"{VARIABLE}KEY: expected {what}")

    def check(self, settings: CallSettings) -> None:
        """Refuse, in one line, a temperature that servers of this kind do not know."""
        if not settings.completion_tokens:
            check_least("temperature", settings.temperature, 0, WARMEST[self.kind], f"a temperature for {self.kind}")

    def complete(self, conversation: Sequence[Message], settings: CallSettings) -> Answer:
        """Ask and return the answer, trying again while the server is busy or at fault.

        Raises:
            CallFailedError: there is no answer; one line without the key.
            ModuleNotFoundError: the extra `llm` is missing.
            ValueError: see `check`.
        """
        self.check(settings)
        ask = CALLS[self.kind](self, conversation, settings)

        def call() -> Answer:
            answer = within(self.limit, lambda: _guarded(ask, self.key))
            finish = None if answer.finish is None else without_key(answer.finish, self.key)[:MAX_WORD]
            return answer._replace(reply=without_key(answer.reply, self.key)[-MAX_READ:], finish=finish)

        return with_patience(call)


def from_environment(environment: Mapping[str, str]) -> Endpoint:
    """Return the endpoint that the variables IPHYRE_JAX_LLM_KIND, _URL, _MODEL and _KEY name; KIND may be missing.

    Raises:
        ValueError: there is none, or a variable is wrong; one line, without the key.
    """
    given = {name: environment.get(VARIABLE + name, "").strip() for name in ("KIND", "URL", "MODEL", "KEY")}
    if not given["URL"] or not given["MODEL"]:
        raise ValueError(NOT_CONFIGURED)
    return Endpoint(given["KIND"] or "openai", given["URL"], given["MODEL"], given["KEY"] or None)


def check_url(name: str, url: str) -> None:
    """Refuse, in one line that does not repeat it, a URL that could betray a key.

    Raises:
        ValueError: it has user, password, query or fragment, or is neither https nor on this machine.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname or "", parts.port
    except ValueError:
        raise ValueError(f"{name}: expected a URL such as https://host/v1") from None
    if not host or parts.username is not None or parts.query or parts.fragment or url != one_line(url):
        raise ValueError(f"{name}: expected a URL such as https://host/v1, without user, query or fragment")
    if parts.scheme != "https" and not (parts.scheme == "http" and is_local(host)):
        raise ValueError(f"{name}: expected https, for the host is not this machine")


def _is_header(key: str) -> bool:
    """Whether a key may stand in a header, and is the same in whatever text a server's answer is shown."""
    return key.isascii() and all("!" <= sign <= "~" and sign not in "\\'\"" for sign in key)


def _guarded(ask: Callable[[], Answer], key: str | None) -> Answer:
    """Ask; any error of a package becomes one line without the key, and without the error that held it."""
    try:
        return ask()
    except Exception as error:  # the packages raise their own errors, those of httpx, and others on wrong answers
        response = getattr(error, "response", None)
        status = getattr(response, "status_code", None)
        what = f"status {status}" if status is not None else type(error).__name__
        text = without_key(f"llm: the call failed ({what}): {error}", key)
        failure = CallFailedError(text, status if isinstance(status, int) else None, _wait(response))
    raise failure


def _wait(response: Any) -> float | None:  # noqa: ANN401 - of a package
    """The seconds that a server asks to wait for, as `Retry-After` states them, or the date there."""
    try:
        stated = response.headers["retry-after"]
    except (AttributeError, KeyError, TypeError):
        return None
    with suppress(ValueError):
        wait = float(stated)
        return wait if math.isfinite(wait) and wait >= 0 else None
    with suppress(ValueError):
        date = parsedate_to_datetime(stated)
        return max(0.0, (date.replace(tzinfo=date.tzinfo or UTC) - datetime.now(UTC)).total_seconds())
    return None

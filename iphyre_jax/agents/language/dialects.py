"""The two dialects: a call of each official package, imported when it is called, with a bridled HTTP client."""

from __future__ import annotations

import base64
import importlib
import ipaddress
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from iphyre_jax.agents.language.calls import MAX_TOKENS, Answer, CallSettings
from iphyre_jax.agents.language.prompts import Message
from iphyre_jax.checks import missing_extra, show

if TYPE_CHECKING:
    from iphyre_jax.agents.language.endpoints import Endpoint

_KEY_HEADERS: Final = frozenset({"authorization", "x-api-key"})
_HEADERS: Final = _KEY_HEADERS | {
    "host",
    "accept",
    "accept-encoding",
    "connection",
    "user-agent",
    "content-type",
    "content-length",
    "anthropic-version",
}
_NO_KEY: Final = "none"  # the packages want a key; a local server asks for none


def is_local(host: str) -> bool:
    """Return whether a host's name or address is this machine."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def package(kind: str) -> Any:  # noqa: ANN401 - a module
    """Import the package of a kind of endpoint, which has its name; ModuleNotFoundError, one line, without `llm`."""
    try:
        return importlib.import_module(kind)
    except ModuleNotFoundError as error:
        raise missing_extra("this endpoint", "llm", error.name) from None


def _openai(endpoint: Endpoint, conversation: Sequence[Message], settings: CallSettings) -> Callable[[], Answer]:
    """A call of chat completions."""
    openai = package("openai")
    chat: Any = [{"role": message.role, "content": _openai_content(message)} for message in conversation]
    if settings.completion_tokens:
        limits: dict[str, Any] = {"max_completion_tokens": settings.max_tokens}
    else:
        limits = {"max_tokens": settings.max_tokens, "temperature": settings.temperature}

    def ask() -> Answer:
        key = endpoint.key or _NO_KEY
        with _http(endpoint, openai) as http:
            client = openai.OpenAI(api_key=key, base_url=endpoint.url, max_retries=0, http_client=http)
            completion = client.chat.completions.create(model=endpoint.model, messages=chat, **limits)
        choice, usage = _listed(completion, "choices", 1)[0], _field(completion, "usage")
        if (message := _field(choice, "message")) is None:
            raise TypeError(f"expected a choice with a message, got {show(choice)}")
        counts = [_count(_field(usage, name)) for name in ("prompt_tokens", "completion_tokens")]
        return Answer(_text(_field(message, "content")), _word(_field(choice, "finish_reason")), counts[0], counts[1])

    return ask


def _anthropic(endpoint: Endpoint, conversation: Sequence[Message], settings: CallSettings) -> Callable[[], Answer]:
    """A call of messages."""
    anthropic = package("anthropic")
    system = "\n".join(message.text for message in conversation if message.role == "system")
    chat: Any = [
        {"role": message.role, "content": _anthropic_content(message)}
        for message in conversation
        if message.role != "system"
    ]

    # In the body, for newer versions of the package have no argument for it.
    more = {} if settings.completion_tokens else {"temperature": settings.temperature}

    def ask() -> Answer:
        key = endpoint.key or _NO_KEY
        with _http(endpoint, anthropic) as http:
            client = anthropic.Anthropic(api_key=key, base_url=endpoint.url, max_retries=0, http_client=http)
            said = client.messages.create(
                model=endpoint.model, system=system, messages=chat, max_tokens=settings.max_tokens, extra_body=more
            )
        reply, usage = _text(_listed(said, "content", 0)), _field(said, "usage")
        counts = [_count(_field(usage, name)) for name in ("input_tokens", "output_tokens")]
        return Answer(reply, _word(_field(said, "stop_reason")), counts[0], counts[1])

    return ask


def _http(endpoint: Endpoint, package: Any) -> Any:  # noqa: ANN401 - of a package
    """The packages' HTTP client: no redirects, which could take the key along; no proxy on the way to this machine.

    The packages read further keys and headers from variables of their own. Only those of `_HEADERS` are sent.
    """
    local = is_local(urlsplit(endpoint.url).hostname or "")

    def strip(request: Any) -> None:  # noqa: ANN401
        for name, value in list(request.headers.items()):
            foreign = endpoint.key is None or endpoint.key not in value
            if name.lower() not in _HEADERS or (name.lower() in _KEY_HEADERS and foreign):
                del request.headers[name]

    return package.DefaultHttpxClient(
        follow_redirects=False,
        trust_env=not local,
        mounts={"http://": None, "https://": None, "all://": None} if local else {},
        timeout=endpoint.limit,
        event_hooks={"request": [strip]},
    )


def _field(thing: object, name: str) -> Any:  # noqa: ANN401 - of a package, which takes answers as they come
    return thing.get(name) if isinstance(thing, Mapping) else getattr(thing, name, None)


def _listed(answer: object, name: str, least: int) -> list[Any]:
    """A list of an answer, or TypeError with what the server says instead: some answer 200 with an error inside."""
    found, error = _field(answer, name), _field(answer, "error")
    if isinstance(found, list) and len(found) >= least:
        return found
    # Whole: the key is hidden in it, and then it is cut.
    got = _field(error, "message") or error or (answer if isinstance(answer, str) else show(found))
    raise TypeError(f"expected an answer with {name}, got {got}")


def _text(value: object) -> str:
    """The text of a reply: itself, or the parts of text in a list; other parts, such as thoughts, are left out.

    Half a character, which JSON can hold and no request can, becomes a question mark.
    """
    if isinstance(value, list):
        return "".join(_text(_field(part, "text")) for part in value if _field(part, "type") == "text")
    if value is not None and not isinstance(value, str):
        raise TypeError(f"expected a reply of text, got {show(value)}")
    return (value or "").encode("utf-8", "replace").decode()


def _word(value: object) -> str | None:
    """Why a reply ended, as far as the server says it in a word; what it adds to an answer must not spoil it."""
    return value if isinstance(value, str) else None


def _count(value: object) -> int | None:
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= MAX_TOKENS:
        return None
    return value


def _openai_content(message: Message) -> str | list[dict[str, Any]]:
    if not message.pictures:
        return message.text
    urls = [f"data:image/png;base64,{base64.b64encode(png).decode()}" for png in message.pictures]
    return [{"type": "text", "text": message.text}, *({"type": "image_url", "image_url": {"url": u}} for u in urls)]


def _anthropic_content(message: Message) -> str | list[dict[str, Any]]:
    if not message.pictures:
        return message.text
    sources = [
        {"type": "base64", "media_type": "image/png", "data": base64.b64encode(png).decode()}
        for png in message.pictures
    ]
    return [*({"type": "image", "source": source} for source in sources), {"type": "text", "text": message.text}]


CALLS: Final[dict[str, Callable[[Endpoint, Sequence[Message], CallSettings], Callable[[], Answer]]]] = {
    "openai": _openai,
    "anthropic": _anthropic,
}

"""One call of a language model: its settings and answer, how it fails, how long it may take, when it is made again.

A call that failed is never an answer. What leaves this module as an error names no key.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any, Final, NamedTuple

from iphyre_jax.checks import check_flag, check_least, check_whole, one_line

LIMIT: Final = 120.0  # s, of one call, whatever the server does
RETRIES: Final = 5
FIRST_WAIT: Final = 1.0  # s; doubled after each retry if the server names none
LONGEST_WAIT: Final = 120.0  # s that a server may ask for
MAX_TOKENS: Final = 1_000_000  # of one reply
HIDDEN: Final = "[key]"
MAX_ERROR: Final = 300  # characters
_SHORTEST_KEY: Final = 8  # characters; shorter ones are placeholders of local servers, and words of any text


@dataclass(frozen=True)
class CallSettings:
    """What decides a reply beside the question.

    Attributes:
        temperature: 0 to 2.
        max_tokens: of a reply.
        completion_tokens: ask without a temperature, as some models want, and with `max_completion_tokens` where the
            kind is "openai".
    """

    temperature: float = 0.5
    max_tokens: int = 2048
    completion_tokens: bool = False

    def __post_init__(self) -> None:
        check_least("temperature", self.temperature, 0, 2)
        check_whole("max_tokens", self.max_tokens, 1, MAX_TOKENS)
        check_flag("completion_tokens", self.completion_tokens)


class Answer(NamedTuple):
    """What a server answered."""

    reply: str
    finish: str | None  # why the reply ended: "stop", "length", ...
    tokens_in: int | None
    tokens_out: int | None
    seconds: float = 0.0


class CallFailedError(OSError):
    """A call that gave no answer: the run ends, can be resumed, and scores nothing for it. One line without the key.

    Attributes:
        status: of HTTP, if the server gave one.
        wait: s, as the server asked for; None if it did not.
    """

    def __init__(self, message: str, status: int | None = None, wait: float | None = None) -> None:
        super().__init__(one_line(message)[:MAX_ERROR])
        self.status, self.wait = status, wait

    @property
    def may_pass(self) -> bool:
        """Whether the same call may succeed later: too many requests, or a fault of the server."""
        return self.status == 429 or (self.status is not None and 500 <= self.status < 600)


def without_key(text: str, key: str | None) -> str:
    """Return a text in which the key is hidden, as servers may send it back; keys under 8 characters are no secrets."""
    return text if key is None or len(key) < _SHORTEST_KEY else text.replace(key, HIDDEN)


def within(seconds: float, call: Callable[[], Answer]) -> Answer:
    """Return what a call returns, or fail after so many seconds, also if the server sends a byte now and then.

    Raises:
        CallFailedError: it took longer. The call goes on in a thread that dies with the process.
    """
    ended: SimpleQueue[Answer | BaseException] = SimpleQueue()

    def run() -> None:
        try:
            ended.put(call())
        except BaseException as error:
            ended.put(error)

    began = time.monotonic()
    threading.Thread(target=run, daemon=True, name="iphyre_jax-call").start()
    try:
        result = ended.get(timeout=seconds)
    except Empty:
        raise CallFailedError(f"llm: expected an answer within {seconds:g} s, got none") from None
    if isinstance(result, BaseException):
        raise result
    return result._replace(seconds=time.monotonic() - began)


def with_patience(call: Callable[[], Answer], sleep: Callable[[float], Any] = time.sleep) -> Answer:
    """Return what a call returns; after 429 and 5xx it is made again, five times at most.

    It waits as long as the server asks, or 1, 2, 4, 8 and 16 s.

    Raises:
        CallFailedError: the last failure; or the server asks for more than two minutes.
    """
    wait = FIRST_WAIT
    for _ in range(RETRIES):
        try:
            return call()
        except CallFailedError as error:
            if not error.may_pass:
                raise
            if (error.wait or 0.0) > LONGEST_WAIT:
                asked = f"llm: the server asks to wait for {error.wait:.0f} s, more than {LONGEST_WAIT:g} s: {error}"
                raise CallFailedError(asked, error.status, error.wait) from None
            sleep(wait if error.wait is None else error.wait)
            wait *= 2
    return call()

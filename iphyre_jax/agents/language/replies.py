"""From a reply to the entries of a plan: a function of any text, which never raises and runs nothing of it.

A reply may think aloud. Candidates are its fenced blocks and, if none of them is an answer, what stands in balanced
brackets. The last one that is a JSON list of objects is the answer. Work grows with the length of the text: brackets
are found in one pass, and at most `WORK` times the text's characters are given to the JSON parser.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, NoReturn, get_args

from iphyre_jax.checks import show
from iphyre_jax.rules import TIME_LIMIT

MAX_READ: Final = 65_536  # characters; of a longer reply the end is read, where answers stand
MAX_DEPTH: Final = 8  # brackets in brackets
WORK: Final = 8  # characters given to the JSON parser, for each character read

_BEFORE_STRING: Final = ("[", "{", ",", ":")

ReplyForm = Literal["plan", "next", "now"]
"""What is asked for: all removals with their times; the next one, counted from now; what goes now, without times."""

FORMS: Final[tuple[ReplyForm, ...]] = get_args(ReplyForm)
Reason = Literal["time", "index", "repeated", "later"]
REASONS: Final[tuple[Reason, ...]] = get_args(Reason)  # why an entry was dropped


class Removal(NamedTuple):
    """An entry of a reply that counts."""

    time: float  # s, 0 to 15; 0 where no times are asked for
    slot: int  # of the block in a plan: its place among the eliminable ones


@dataclass(frozen=True)
class Parsed:
    """What was read in a reply.

    Attributes:
        removals: the entries that count, by time, equal times in the order of the reply.
        dropped: how many entries were dropped, by reason.
        problem: why nothing could be read, in one line; None if there is an answer, be it to do nothing.
    """

    removals: tuple[Removal, ...] = ()
    dropped: Mapping[Reason, int] = field(default_factory=dict)
    problem: str | None = None


def parse_reply(
    text: str,
    blocks: int,
    form: ReplyForm = "plan",
    latest: float = TIME_LIMIT,
    gone: Set[int] = frozenset(),
) -> Parsed:
    """Read a reply; total: there is no text for which it raises.

    Args:
        text: the reply.
        blocks: eliminable blocks of the game, which bounds `index`.
        form: what was asked for.
        latest: s, that an entry may name: what is left of the 15 s.
        gone: slots of the blocks that were removed before.

    Returns:
        The removals. An entry is dropped for its "time" (no finite number from 0 to `latest`, or a boolean), its
        "index" (no whole number below `blocks`), because its block is gone or has one already ("repeated"), or, of the
        form "next", because another entry comes before it ("later"). Nothing is clamped.
    """
    found = _last_answer(text[-MAX_READ:])
    if found is None:
        return Parsed(problem="no JSON list of objects was found")
    removals: list[Removal] = []
    dropped: Counter[Reason] = Counter()
    taken = set(gone)
    for entry in found:
        time = 0.0 if form == "now" else _time(entry.get("time"), latest)
        index = _index(entry.get("index"), blocks)
        if index is None or time is None:
            dropped["index" if index is None else "time"] += 1
        elif index in taken:
            dropped["repeated"] += 1
        else:
            taken.add(index)
            removals.append(Removal(time, index))
    removals.sort(key=lambda removal: removal.time)
    if form == "next" and len(removals) > 1:
        dropped["later"] += len(removals) - 1
        del removals[1:]
    return Parsed(tuple(removals), dict(dropped))


def _time(value: object, latest: float) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= latest:
        return None
    return float(value)


def _index(value: object, blocks: int) -> int | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < blocks or value != int(value):
        return None
    return int(value)


def _last_answer(text: str) -> list[dict[str, object]] | None:
    """The last fenced block that is a list of objects, else the last such list in brackets."""
    for block in reversed(list(_fenced(text))):
        if (answer := _objects(block)) is not None:
            return answer
    return _last_list(text)


def _fenced(text: str) -> Iterator[str]:
    """What stands between lines that begin with three backticks; the last block may lack its end."""
    inside: list[str] | None = None
    for line in text.split("\n"):
        if line.lstrip().startswith("```"):
            if inside is not None:
                yield "\n".join(inside)
            inside = [] if inside is None else None
        elif inside is not None:
            inside.append(line)
    if inside is not None:
        yield "\n".join(inside)


class _Pair(NamedTuple):
    start: int
    end: int  # one after the closing bracket
    depth: int  # of the nesting inside, the pair itself included


def _last_list(text: str) -> list[dict[str, object]] | None:
    """The last outermost pair of brackets that holds an answer; where one does not, those inside it are tried."""
    budget = WORK * len(text)
    refused = len(text)  # inside a pair that is nested too deeply nothing is tried
    for pair in sorted(_pairs(text), key=lambda found: (-found.end, found.start)):
        if pair.start >= refused:
            continue
        if pair.depth > MAX_DEPTH:
            refused = pair.start
            continue
        budget -= pair.end - pair.start
        if budget < 0:
            break
        if (answer := _objects(text[pair.start : pair.end])) is not None:
            return answer
    return None


def _pairs(text: str) -> Iterator[_Pair]:
    """The balanced square brackets outside strings.

    Prose has quotation marks too: a string begins inside a bracket, after a sign after which JSON may have one, and
    ends with its line at last.
    """
    opened: list[list[int]] = []  # start of each open bracket, and the depth of what it holds
    quoted = escaped = False
    before = ""  # the last sign that is no space
    for at, sign in enumerate(text):
        if quoted:
            quoted = sign != "\n" and (escaped or sign != '"')
            escaped = sign == "\\" and not escaped
        elif sign == '"':
            quoted, escaped = bool(opened) and before in _BEFORE_STRING, False
        elif sign == "[":
            opened.append([at, 0])
        elif sign == "]" and opened:
            start, inner = opened.pop()
            if opened:
                opened[-1][1] = max(opened[-1][1], inner + 1)
            yield _Pair(start, at + 1, inner + 1)
        if not sign.isspace():
            before = sign


def _objects(text: str) -> list[dict[str, object]] | None:
    """The JSON list of objects that a text is; None for any other text."""
    try:
        value = json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)
    except (ValueError, RecursionError):  # no JSON, NaN, an integer of thousands of digits; too deep
        return None
    return value if isinstance(value, list) and all(isinstance(entry, dict) for entry in value) else None


def _refuse(name: str) -> NoReturn:
    raise ValueError(f"expected a finite number, got {name}")


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """An object; ValueError if a field stands twice, or a number is no finite one, such as 1e999."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("expected each field once")
    for value in found.values():
        if isinstance(value, float) and value in (float("inf"), float("-inf")):
            raise ValueError(f"expected finite numbers, got {show(value)}")
    return found

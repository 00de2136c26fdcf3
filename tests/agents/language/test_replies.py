"""Replies: what counts, what is dropped, and that no text breaks the parser or makes it work without bound."""

from __future__ import annotations

import ast
import inspect
import json
import sys
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from iphyre_jax.agents.language import replies
from iphyre_jax.agents.language.replies import FORMS, MAX_DEPTH, MAX_READ, WORK, ReplyForm, parse_reply

GOOD = '[{"time": 0.5, "index": 1}]'


def plan(text: str, form: ReplyForm = "plan") -> list[tuple[float, int]]:
    parsed = parse_reply(text, 3, form)
    assert parsed.problem is None, parsed.problem
    return [tuple(removal) for removal in parsed.removals]  # type: ignore[misc]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (GOOD, [(0.5, 1)]),
        ("[]", []),
        (f"I think [see above] that\n{GOOD}\nis best.", [(0.5, 1)]),
        (f"First [{{'no': 1}}] then {GOOD}", [(0.5, 1)]),
        (f'[{{"time": 9, "index": 0}}] no, better {GOOD}', [(0.5, 1)]),  # the last one
        (f'```json\n{GOOD}\n```\nnot [{{"time": 9, "index": 0}}]', [(0.5, 1)]),  # a fenced one first
        (f"```json\n[1]\n```\n{GOOD}", [(0.5, 1)]),  # a fenced block that is no answer does not hide one
        (f"```\n{GOOD}", [(0.5, 1)]),  # cut off before the fence ends
        (f'A 5" ball [of course" {GOOD}', [(0.5, 1)]),  # quotes and brackets of prose
        ('[{"time": 1, "index": 2, "why": "a ] in [ a string \\" "}]', [(1, 2)]),
        ('[{"time": 1, "index": 2, "tags": []}]', [(1, 2)]),  # not the empty list inside
        ('[{"time": 2, "index": 0}, {"time": 1, "index": 1}, {"time": 1, "index": 2}]', [(1, 1), (1, 2), (2, 0)]),
        ('[{"time": 15, "index": 2.0}, {"time": 0, "index": 0}]', [(0, 0), (15, 2)]),
        (f'{{"actions": {GOOD}}}', [(0.5, 1)]),
        ("x" * MAX_READ + GOOD, [(0.5, 1)]),  # the end of a long one is read
    ],
)
def test_a_plan_is_read(text: str, expected: list[tuple[float, int]]) -> None:
    assert plan(text) == expected


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ('{"time": -0.1, "index": 0}', "time"),
        ('{"time": 15.01, "index": 0}', "time"),
        ('{"time": true, "index": 0}', "time"),
        ('{"time": "1", "index": 0}', "time"),
        ('{"time": null, "index": 0}', "time"),
        ('{"index": 0}', "time"),
        (f'{{"time": {10**400}, "index": 0}}', "time"),
        ('{"time": 1, "index": 3}', "index"),
        ('{"time": 1, "index": -1}', "index"),
        ('{"time": 1, "index": 0.5}', "index"),
        ('{"time": 1, "index": false}', "index"),
        ('{"time": 1, "index": [0]}', "index"),
        ('{"time": 1}', "index"),
        (f'{{"time": 1, "index": {10**400}}}', "index"),
        ('{"time": 3, "index": 1}', "repeated"),
    ],
)
def test_an_entry_is_dropped_and_counted(entry: str, reason: str) -> None:
    parsed = parse_reply(f'[{{"time": 0.5, "index": 1}}, {entry}]', 3)
    assert parsed.removals == ((0.5, 1),)
    assert parsed.dropped == {reason: 1}


def test_only_the_next_removal_counts_where_one_is_asked_for() -> None:
    parsed = parse_reply('[{"time": 2, "index": 0}, {"time": 1, "index": 1}]', 3, "next")
    assert (parsed.removals, parsed.dropped) == (((1, 1),), {"later": 1})


def test_what_is_gone_or_after_the_end_is_dropped_and_the_next_entry_counts() -> None:
    text = '[{"time": 1, "index": 0}, {"time": 3, "index": 2}, {"time": 2, "index": 1}]'
    parsed = parse_reply(text, 3, "next", 2.5, {0})
    assert (parsed.removals, parsed.dropped) == (((2, 1),), {"repeated": 1, "time": 1})


def test_what_goes_now_needs_no_time() -> None:
    assert plan('[{"index": 2}, {"index": 0, "time": "soon"}]', "now") == [(0, 2), (0, 0)]


# fmt: off
HOSTILE = [
    "", " ", "\0", "\ud800", "[", "]", "[[", "]]", "{", "}", '"', "\\", "```", "``````", "```json", "~~~", "null",
    "[1]",
    "[[]", "[]]x[", "[null]", "[true]", "[NaN]", '[{"time": NaN, "index": 0}]', '[{"time": Infinity, "index": 0}]',
    '[{"time": -Infinity, "index": 0}]', '[{"time": 1e999, "index": 0}]', '[{"time": 1, "index": 0]', "[{]}", "{[}]",
    '[{"time": 1, "time": 2, "index": 0}]', "[{'time': 1, 'index': 0}]", '[{"time": 1, "index": 0,}]', "[{}, 1]",
    '{"time": 1, "index": 0}', "__import__('os').system('exit 1')", "[__import__('os')]", "[{**{}}]", "[{'a': open}]",
    '[{"time": 1 + 1, "index": 0}]', '[{"time": 0x1, "index": 0}]', '[{"time": 01, "index": 0}]', "[" * 100_000,
    "]" * 100_000, "[" * 50_000 + "]" * 50_000, "[" * 9 + "]" * 9, '{"a":' * 50_000, "[{" * 30_000, '"' * 99_999,
    "\\" * 99_999, '["' * 30_000, "[" + "1," * 40_000, "```\n" * 20_000, "[]," * 30_000 + "[",
    "[" + "9" * 60_000 + "]",
    "[{" + '"a":1,' * 9_000 + "}]", "[" + "{}," * 20_000 + "]", "[" + '{"time":1e-99999},' * 3_000 + "]",
    "[x]" * 20_000,
    "\ufeff[]x", "[\u2028]", "[{\u201ctime\u201d: 1}]", "<answer>[</answer>", "[//]\n", "[/* */]", "[...]", "[?]",
    "[-]",
]
# fmt: on
PIECES = ("[", "]", "{", "}", '"', "\\", "```\n", "NaN", '{"time": 1, "index": 0}', ",", "\n", "[]", "prose ", "\x00")


def hostile() -> list[str]:
    """More than two hundred texts: by hand, and all pairs and repetitions of pieces."""
    return [*HOSTILE, *(a + b for a in PIECES for b in PIECES), *(piece * 5_000 for piece in PIECES)]


def test_there_are_enough_hostile_replies() -> None:
    assert len(set(hostile())) >= 200


@pytest.mark.parametrize("form", FORMS)
def test_no_hostile_reply_raises_or_gives_what_is_out_of_range(form: ReplyForm) -> None:
    for text in hostile():
        if form == "plan" or len(text) < 10_000:  # the forms differ in what they do with entries alone
            check(text, form)


@pytest.mark.parametrize("text", [text for text in HOSTILE if "time" in text or "[1" in text])
def test_what_is_no_answer_has_a_problem_in_one_line(text: str) -> None:
    if "1e-99999" not in text:
        parsed = parse_reply(text, 3)
        assert parsed.removals == ()
        assert parsed.problem
        assert "\n" not in parsed.problem


def check(text: str, form: ReplyForm) -> None:
    parsed = parse_reply(text, 3, form)
    assert all(0 <= time <= 15 and index in (0, 1, 2) for time, index in parsed.removals)
    assert len({index for _, index in parsed.removals}) == len(parsed.removals)
    assert list(parsed.removals) == sorted(parsed.removals, key=lambda removal: removal.time)
    assert parsed.problem is None or not parsed.removals


@given(st.text(max_size=300) | st.lists(st.sampled_from(PIECES), max_size=40).map("".join), st.sampled_from(FORMS))
@settings(max_examples=60)
def test_no_text_raises(text: str, form: ReplyForm) -> None:
    check(text, form)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["time", "index", "x"]), inner),
    max_leaves=10,
)


@given(st.lists(json_values, max_size=5))
@settings(max_examples=60)
def test_no_json_raises(value: Any) -> None:
    check("so: " + json.dumps(value), "plan")


@given(st.lists(st.tuples(st.floats(0, 15), st.integers(0, 2)), max_size=3, unique_by=lambda pair: pair[1]))
@settings(max_examples=40)
def test_a_valid_plan_comes_back_sorted(pairs: list[tuple[float, int]]) -> None:
    text = json.dumps([{"time": time, "index": index} for time, index in pairs])
    assert plan(f"thinking [...]\n```json\n{text}\n```") == sorted(pairs, key=lambda pair: pair[0])


@pytest.mark.parametrize("text", [t for t in HOSTILE if len(t) > 10_000] + ["[a" * 7 + "]" * 7 + "[b]" * 20_000])
def test_work_is_linear_in_the_length(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Characters given to the JSON parser, and the pairs found in one pass, are bounded by the length of the text."""
    real, given_characters = replies._objects, 0

    def counted(part: str) -> list[dict[str, object]] | None:
        nonlocal given_characters
        given_characters += len(part)
        return real(part)

    monkeypatch.setattr(replies, "_objects", counted)
    parse_reply(text, 3)
    assert given_characters <= (WORK + 1) * min(len(text), MAX_READ)
    assert sum(1 for _ in replies._pairs(text)) <= len(text)


def test_brackets_nested_too_deeply_are_refused_whole() -> None:
    assert plan("[" * (MAX_DEPTH - 1) + GOOD + "]" * (MAX_DEPTH - 1)) == [(0.5, 1)]
    assert parse_reply("[" * MAX_DEPTH + GOOD + "]" * MAX_DEPTH, 3).problem


def test_the_parser_knows_no_way_to_run_code() -> None:
    names = {node.id for node in ast.walk(ast.parse(inspect.getsource(replies))) if isinstance(node, ast.Name)}
    assert names.isdisjoint({"eval", "exec", "compile", "__import__", "literal_eval", "open"})
    assert "ast" not in vars(replies)
    assert sys.getrecursionlimit() < MAX_READ  # deep JSON meets the limit, which the parser takes as unreadable

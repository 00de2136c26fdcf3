"""Films of both engines: bad input gets one line."""

from __future__ import annotations

import sys

import pytest

from parity.reports import film


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["nosuch"], "scene: expected "), (["hole", "--plan", "x"], "plan: expected "), (["hole", "--fps", "0"], "fps: ")],
)
def test_bad_options_get_one_line(
    arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["film", *arguments])
    assert film.main() == 2
    said = capsys.readouterr().err
    assert said.startswith(message)
    assert said.count("\n") == 1
